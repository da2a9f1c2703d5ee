"""Closed-form pair of an intensified and a thermal frame with known truth.

Two lamps with halos, two floodlights beyond full scale, and twelve objects: in the dark, in halos
and inside the floodlights, each with contrast in both bands, of opposite sign, and in one band
alone. Nothing here is taken from the package: light is blurred by a Gaussian and a flat halo,
becomes photoelectrons (Poisson) with exponential pulse heights (F^2 = 2), is blurred again after
the gain, and is rounded to 8 bits.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from charact.estimators.bloom import PosteriorPsf, bloom_map
from charact.frames import NoiseLaw
from charact.fusion import Band, FusionTruth

SHAPE = (240, 320)
ZONES = ("dark", "halo", "core")
# Sign of the contrast in the visible and in the thermal band, of the four objects of a zone.
CONTRASTS = ((1, 1), (1, -1), (1, 0), (0, 1))


def gaussian(image: NDArray, sigma: float) -> NDArray:
    """Blur by a sampled Gaussian, periodic."""
    return gaussian_filter(np.asarray(image, float), sigma, mode="wrap", truncate=6.0)


@dataclass(frozen=True)
class Pair:
    """Scene and cameras; frames are drawn by `frames`."""

    seed: int = 1
    ground_pe: float = 8.0
    gain_dn: float = 4.0
    dark_dn: float = 10.0
    read_dn: float = 1.0
    excess: float = 2.0
    post_gain_px: float = 0.6
    core_px: float = 0.8
    halo_fraction: float = 0.1
    halo_px: float = 30.0
    lamp_pe: float = 3.5e5
    flood_pe: float = 90.0
    visible_pe: float = 2.0
    thermal_k: float = 0.3
    netd_k: float = 0.2
    lamps: tuple[tuple[int, int], ...] = ((62, 72), (70, 250))
    floods: tuple[tuple[int, int], ...] = ((180, 82), (172, 238))
    flood_px: float = 18.0
    # Contrast of the ground, its coarse and fine scale, px, and the share that both bands have in
    # common, -1 to 1.
    texture: float = 1.0
    scales_px: tuple[float, float] = (22.0, 6.0)
    common: float = 0.0
    buildings: float = 0.0

    @property
    def full_dn(self) -> float:
        """Full scale above dark."""
        return 255.0 - self.dark_dn

    @property
    def covariance_gain(self) -> float:
        """k F^2 (no electrons of a detector), DN."""
        return self.gain_dn * self.excess

    @cached_property
    def places(self) -> dict[str, list[tuple[int, int]]]:
        (a, b), (c, d) = self.lamps, self.floods
        beside = lambda p, dr, dc: (p[0] + dr, p[1] + dc)  # noqa: E731
        return {
            "dark": [(28, 160), (88, 160), (148, 160), (214, 160)],
            "halo": [beside(a, 0, 17), beside(a, 4, -17), beside(b, 2, 17), beside(b, -4, -17)],
            "core": [beside(c, 0, 8), beside(c, 0, -8), beside(d, 0, 8), beside(d, 0, -8)],
        }

    def disc(self, row: float, col: float, radius: float) -> NDArray:
        rows, cols = np.indices(SHAPE)
        return np.clip(radius + 0.5 - np.hypot(rows - row, cols - col), 0.0, 1.0)

    @cached_property
    def objects(self) -> list[tuple[str, tuple[int, int], NDArray]]:
        """Zone, signs and mask of each object."""
        out = []
        for zone, centres in self.places.items():
            for signs, (row, col) in zip(CONTRASTS, centres, strict=True):
                out.append((zone, signs, self.disc(row, col, 4.5)))
        return out

    @cached_property
    def scene(self) -> tuple[NDArray, NDArray]:
        """Ground and objects without lamps and halos: photoelectrons, and K."""
        rng = np.random.default_rng(self.seed)
        visible, thermal = (
            self.texture
            * (self._smooth(rng, self.scales_px[0]) + 0.3 * self._smooth(rng, self.scales_px[1]))
            for _ in range(2)
        )
        thermal = self.common * visible + (1.0 - self.common**2) ** 0.5 * thermal
        rows, _ = np.indices(SHAPE)
        horizon = 1.0 / (1.0 + np.exp((rows - 118) / 2.0))
        visible = self.ground_pe + 1.2 * visible - 1.2 * horizon
        thermal = 0.13 * thermal - 0.2 * horizon
        # Walls that both bands see, with contrasts of either sign.
        for row, col, sign in (
            (20, 30, 1),
            (35, 210, -1),
            (125, 20, -1),
            (130, 130, 1),
            (200, 150, 1),
            (205, 280, -1),
        ):
            wall = np.zeros(SHAPE)
            wall[row : row + 26, col : col + 34] = self.buildings
            visible, thermal = visible + 2.5 * wall, thermal + 0.4 * sign * wall
        for _, (visible_sign, thermal_sign), mask in self.objects:
            visible = visible + visible_sign * self.visible_pe * mask
            thermal = thermal + thermal_sign * self.thermal_k * mask
        return gaussian(np.maximum(visible, 0.5), self.core_px), gaussian(thermal, 1.0)

    @staticmethod
    def _smooth(rng: np.random.Generator, scale: float) -> NDArray:
        field = gaussian(rng.normal(size=SHAPE), scale)
        return field / field.std()

    @cached_property
    def light(self) -> NDArray:
        """Photoelectrons of the lamps alone, blurred and with halos."""
        sources = np.zeros(SHAPE)
        for row, col in self.lamps:
            sources[row, col] += self.lamp_pe
        for row, col in self.floods:
            sources += self.flood_pe * self.disc(row, col, self.flood_px)
        big = np.pad(sources, 64)
        blurred = gaussian(
            (1.0 - self.halo_fraction) * big + self.halo_fraction * self.spread(big), self.core_px
        )
        return np.maximum(blurred[64:-64, 64:-64], 0.0)

    def spread(self, light: NDArray) -> NDArray:
        """Spread light uniformly over the disc of the halo, periodic."""
        rows, cols = np.indices(light.shape)
        radius = np.hypot(rows - light.shape[0] // 2, cols - light.shape[1] // 2)
        disc = np.clip(self.halo_px + 0.5 - radius, 0.0, 1.0)
        spectrum = np.fft.rfft2(np.fft.ifftshift(disc / disc.sum()))
        return np.fft.irfft2(np.fft.rfft2(light) * spectrum, s=light.shape)

    @cached_property
    def mean_pe(self) -> NDArray:
        """Photoelectrons of scene and lamps with their halos."""
        ground_halo = self.halo_fraction / (1.0 - self.halo_fraction) * self.spread(self.scene[0])
        return self.scene[0] + ground_halo + self.light

    @cached_property
    def zones(self) -> dict[str, NDArray]:
        """Pixels of the dark, of halos, and of the floodlights."""
        top = self.full_dn / self.gain_dn
        core = gaussian((self.mean_pe > top).astype(float), 1.0) > 0.02
        lit = self.light > 2.0
        patch = (
            sum(
                (self.disc(row, col, self.flood_px - 3.0) for row, col in self.floods),
                np.zeros(SHAPE),
            )
            > 0.5
        )
        return {"dark": self.light < 0.1, "halo": lit & ~core, "core": patch}

    def frames(self, rng: np.random.Generator) -> tuple[NDArray, NDArray]:
        """Draw one pair: DN above dark (whole numbers, clipped at full scale), and K."""
        mean = self.mean_pe
        capped = np.minimum(mean, 2e4)
        electrons = rng.poisson(capped)
        pulses = np.where(
            electrons > 0, rng.gamma(np.maximum(electrons, 1) / (self.excess - 1.0)), 0.0
        )
        signal = gaussian(pulses * (self.excess - 1.0) * self.gain_dn, self.post_gain_px)
        dn = np.rint(signal + self.dark_dn + self.read_dn * rng.normal(size=SHAPE))
        thermal = self.scene[1] + self.netd_k * rng.normal(size=SHAPE)
        return np.clip(dn, 0.0, 255.0) - self.dark_dn, thermal

    @cached_property
    def truth(self) -> FusionTruth:
        """Bands without noise and lamps, zones, objects by number from 1, and halos of the point
        lamps.
        """
        objects = np.zeros(SHAPE, int)
        for number, (_, _, mask) in enumerate(self.objects, start=1):
            objects[mask > 0.5] = number
        halos = np.array([(*lamp, self.halo_px) for lamp in self.lamps], float).reshape(-1, 3)
        visible, thermal = self.scene
        bands = np.stack([visible * self.gain_dn, thermal])
        return FusionTruth(bands=bands, zones=self.zones, objects=objects, halos=halos)


def psf_of(pair: Pair, halo_px: float | None = None) -> PosteriorPsf:
    """Point spread function of the pair's visible camera, one draw; `halo_px`: another halo
    radius.
    """
    return PosteriorPsf(
        halo_diameter_px=np.array([2.0 * (halo_px or pair.halo_px)]),
        elastic_share=np.array([0.0]),
        halo_fraction=np.array([pair.halo_fraction]),
        core_frequency_cy_per_px=np.array([np.inf]),
        core_exponent=np.array([2.0]),
        core_spread_px2=np.array([pair.core_px**2 + pair.post_gain_px**2]),
        flat_share=1.0,
    )


def bands_of(
    pair: Pair,
    frames: tuple[NDArray, NDArray],
    *,
    halo_px: float | None = None,
    with_map: bool = True,
) -> tuple[Band, Band]:
    """Bands of a pair of frames with their noise laws and the bloom map of the visible one."""
    visible, thermal = frames
    bloom = None
    if with_map:
        bloom = bloom_map.bloom_map(
            visible,
            psf_of(pair, halo_px),
            clip_dn=pair.full_dn,
            clipped=visible >= 0.985 * pair.full_dn,
            most_draws=1,
            rng=np.random.default_rng(0),
        )
    # Rounding to whole numbers adds 1/12 to the variance.
    law = NoiseLaw(
        gain_dn=pair.covariance_gain,
        read_dn=(pair.read_dn**2 + 1 / 12) ** 0.5,
        blur_px=pair.post_gain_px,
    )
    return (
        Band(name="visible", image=visible, noise=law, clip=pair.full_dn, bloom=bloom),
        Band(name="thermal", image=thermal, noise=NoiseLaw(gain_dn=0.0, read_dn=pair.netd_k)),
    )
