"""Do edge, bars, points and the noise of flats of one camera agree as often as promised, and is a fault found out?

Sessions of closed form: one blur before the gain, one behind it and the square pixel, drawn anew for each session.
`charact.study.session.consistency_table` measures a hundred of them and prints what came of it.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact import mtf
from charact.method import Context
from charact.session_measurement import with_stack_label
from charact.study.bars.strips import StripScene
from charact.study.edge.scene import EdgeScene, TrueBlur, level_crossing
from charact.study.flats.noise_spectrum_cases import ScintillatingFlats
from charact.study.point.scene import PointScene
from labdata.measurement import Result
from labdata.session import Kind

Array = NDArray[np.float64]

BARS_CY_PER_PX = (0.08, 0.15, 0.25)
KINDS: dict[str, Kind] = {"edge": "edge", **{f"bars-{f:g}": "bars" for f in BARS_CY_PER_PX}, "point": "point"}


@dataclass(frozen=True)
class TrueCameraChain:
    """Blur before the gain and Gaussian blur behind it, and the square pixel: usable wherever a `TrueBlur` is."""

    before: TrueBlur
    pulse_px: float

    def transfer(self, fx: Array | float, fy: Array | float) -> Any:
        """MTF at frequencies along rows and columns, cycles per pixel, pixel included."""
        return self.before.transfer(fx, fy) * np.exp(-2 * (np.pi * np.hypot(fx, fy) * self.pulse_px) ** 2)

    def mtf(self, frequency_cy_per_px: Array | float, angle_deg: float) -> Any:
        """MTF along a direction, pixel included."""
        f, angle = np.asarray(frequency_cy_per_px, float), np.deg2rad(angle_deg)
        return self.transfer(f * np.cos(angle), f * np.sin(angle))

    def with_defocus(self, share: float) -> "TrueCameraChain":
        """The same chain, all its blur before the pixel wider by a share."""
        if self.before.form == "gaussian":
            before = replace(self.before, sigma_px=self.before.sigma_px * (1 + share))
        else:
            before = replace(self.before, frequency_cy_per_px=self.before.frequency_cy_per_px / (1 + share))
        return replace(self, before=before, pulse_px=self.pulse_px * (1 + share))


@dataclass(frozen=True, kw_only=True)
class SessionScene:
    """One camera before an edge, three groups of bars, a point and even light.

    Parameters
    ----------
    chain
        Its blur.
    edge_deg, bars_deg
        Tilt of the edge and of the bars, degrees.
    edge_snr, bars_snr
        Step over the noise of one pixel of the mean frame.
    offset_px
        Places of edge, bars and point in their pixel.
    photoelectrons
        Of the point, in a frame.
    """

    chain: TrueCameraChain
    edge_deg: float
    bars_deg: float
    edge_snr: float
    bars_snr: float
    offset_px: tuple[float, float]
    photoelectrons: float

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "SessionScene":
        """A camera and its targets at random: Gaussian blur or the form of tubes before the gain."""
        if rng.random() < 0.5:
            before = TrueBlur(sigma_px=rng.uniform(0.5, 1.1))
        else:
            before = TrueBlur(
                form="exponential", frequency_cy_per_px=rng.uniform(0.2, 0.45), exponent=rng.uniform(1.1, 1.7)
            )
        return cls(
            chain=TrueCameraChain(before, rng.uniform(0.5, 0.8)),
            edge_deg=rng.uniform(3.0, 12.0),
            bars_deg=rng.uniform(1.0, 6.0),
            edge_snr=rng.uniform(15.0, 50.0),
            bars_snr=rng.uniform(15.0, 40.0),
            offset_px=(rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.5)),
            photoelectrons=rng.uniform(1500.0, 5000.0),
        )

    def measured(self, rng: np.random.Generator, context: Context, *, defocus: float = 0.0, of: str = "edge") -> Result:
        """Draw every target's frames and measure them.

        Parameters
        ----------
        rng, context
            Generator of the frames, and what the methods are told.
        defocus, of
            Share by which the blur of the targets whose label begins so is wider.
        """
        result = Result()
        for label in KINDS:
            chain = self.chain.with_defocus(defocus) if defocus and label.startswith(of) else self.chain
            result += with_stack_label(self._target(label, chain, rng, context), label)
        flats = ScintillatingFlats(
            half_frequency_cy_per_px=float(np.sqrt(np.log(2.0) / 2.0) / (np.pi * self.chain.pulse_px)), exponent=2.0
        )
        return result + mtf.measure_flats(flats.session_drawn(rng), context=context)

    def _target(self, label: str, chain: TrueCameraChain, rng: np.random.Generator, context: Context) -> Result:
        blur: Any = chain
        if label == "edge":
            edge = EdgeScene(
                blur=blur, angle_deg=self.edge_deg, offset_px=self.offset_px[0], snr=self.edge_snr,
                noise_blur_px=chain.pulse_px, dark_dn=200.0, bright_dn=1800.0, full_scale_dn=4095.0,
            )  # fmt: skip
            return mtf.measure("edge", edge.frames_drawn(rng), context=context)
        if label == "point":
            point = PointScene(
                blur=chain.before, pulse_px=chain.pulse_px, photoelectrons=self.photoelectrons,
                row_px=self.offset_px[0], col_px=self.offset_px[1], peak_dn=2500.0, full_scale_dn=4095.0,
            )  # fmt: skip
            return mtf.measure("point", point.frames_drawn(rng), context=context)
        frequency = float(label.removeprefix("bars-"))
        strip = StripScene(
            blur=blur, frequency_cy_per_px=frequency, angle_deg=self.bars_deg, phase_px=self.offset_px[1],
            snr=self.bars_snr, noise_blur_px=chain.pulse_px,
        )  # fmt: skip
        asked = {"bars": strip.bars, "frequency_cy_per_px": frequency}
        return mtf.measure("bars", strip.frames_drawn(rng), context=context, **asked)

    def context(self, seed: int, *, quick: bool) -> Context:
        """What methods are told: nothing of the camera."""
        return Context(seed=seed, quick=quick)

    def truth_at(self, level: float, angle_deg: float) -> float:
        """Frequency along a direction at which the MTF falls to a level, cycles per pixel."""
        return level_crossing(lambda f: self.chain.mtf(f, angle_deg), level)
