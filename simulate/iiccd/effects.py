"""What each effect of the intensified camera can change in a picture at most, as a share of the temporal noise there.

Estimates are bounds made from the expected picture in photoelectrons and the camera's numbers: no frame is drawn and no
stage is run. A change of the mean counts as it is; a change of the noise counts as the relative change of its standard
deviation; a change of its shape counts at the level that one pixel in a thousand exceeds.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from labdata.conditions import Conditions
from labdata.errors import BadInput
from simulate.economy import DEFAULT_TOLERANCE, Effect, Plan, plan_of
from simulate.iiccd import photons, truth
from simulate.iiccd.camera import IntensifiedCamera
from simulate.iiccd.ccd import Ccd
from simulate.iiccd.light import Light, product
from simulate.iiccd.microchannel import MicrochannelPlate
from simulate.iiccd.streamed.kernel import noise_kernel
from simulate.iiccd.streamed.prepare import Stages
from simulate.iiccd.transfer import Blur, Halo
from simulate.iiccd.video import Video

# Largest of a picture's normal numbers, in standard deviations.
EXTREME = 5.0
# Level that one normal number in a thousand exceeds.
ONE_IN_A_THOUSAND = 3.09
# Seconds that effects cost for a million pixels, once and a frame, as `python -m benchmarks.effects` measures them.
SETUP_S = {"fibre geometry": 3.0, "local depletion": 0.5, "chicken wire": 0.6, "screen mottle": 0.4}
FRAME_S = {
    "afterglow": 2.5e-3,
    "overflow": 1.0e-3,
    "unequal pixels": 0.2e-3,
    "dark pattern": 0.2e-3,
    "pulse-height law": 1.0e-3,
}


@dataclass(frozen=True)
class Picture:
    """The picture that a camera is about to take, as a bound needs it.

    Parameters
    ----------
    camera
        The camera, nothing left out.
    photoelectrons
        Expected photoelectrons per pixel as read and exposure, dark ones left out, shape (row, col).
    conditions
        Gate, voltage and temperature.
    """

    camera: IntensifiedCamera
    photoelectrons: NDArray[np.floating]
    conditions: Conditions

    def __post_init__(self) -> None:
        if self.camera.left_out:
            raise BadInput(f"a plan must begin with all effects, got a camera without {sorted(self.camera.left_out)}")

    @cached_property
    def stages(self) -> Stages:
        """The camera's stages."""
        return Stages.of(self.camera.chain(self.conditions), self.camera.fields_per_frame)

    @cached_property
    def plate(self) -> MicrochannelPlate:
        """The plate."""
        return self.camera.plate(self.conditions)

    @cached_property
    def ccd(self) -> Ccd:
        """The CCD."""
        return self.stages.ccd

    @cached_property
    def dark_pe(self) -> float:
        """Dark photoelectrons per pixel and exposure."""
        cathode = self.camera.photocathode(self.conditions)
        return cathode.ebi_per_s_cm2 * cathode.open_s * truth.field_pixel_area_cm2(self.camera)

    @cached_property
    def expected(self) -> NDArray[np.float64]:
        """Photoelectrons per pixel and exposure, dark ones included, shape (row, col)."""
        return np.asarray(self.photoelectrons, np.float64) + self.dark_pe

    @cached_property
    def unsaturated_e(self) -> float:
        """CCD electrons per photoelectron of a plate at rest."""
        sensor = self.camera.sensor
        optical = float(sensor.phosphor.photons_per_electron) * float(sensor.taper.transmission)
        behind = optical * self.ccd.quantum_efficiency
        return self.plate.gain * behind

    @cached_property
    def load(self) -> NDArray[np.float64]:
        """Output of the plate at rest over its saturating output, by place, shape (row, col)."""
        area = truth.field_pixel_area_cm2(self.camera)
        output = self.plate.gain * self.expected / area / self.plate.field_s
        return output / self.plate.saturation_e_per_s_cm2

    @cached_property
    def charge_e(self) -> float:
        """CCD electrons per photoelectron under the mean load."""
        return self.unsaturated_e / (1.0 + float(self.load.mean()))

    @cached_property
    def impulse(self) -> NDArray[np.float64]:
        """Impulse response along a line."""
        return np.asarray(self.camera.video().low_pass.impulse_response(), float)

    @cached_property
    def pulses(self) -> tuple[float, float]:
        """Variance and third moment of one photoelectron's share of a pixel, over the first moment, e- and e-^2."""
        cells = self.camera.cells
        blurs = self.stages.behind_plate.mean(Light(values=np.zeros((1, 1), np.float32))).owed
        height = 2 if self.camera.interlaced else 1
        kernel = noise_kernel(blurs, cells, height, tuple(self.impulse.tolist()), 0.0, sparse=False)
        shares = self.camera.afterglow(self.conditions).pulse_shares[:, 0]
        shape, probability = self.plate.pulse_height_shape, self.plate.detection_probability
        each = self.charge_e / probability
        second = each * (1.0 + 1.0 / shape) * kernel.blur_factor * float(np.mean(shares**2))
        third = each**2 * (1.0 + 1.0 / shape) * (1.0 + 2.0 / shape) * kernel.third_factor * float(np.mean(shares**3))
        return second, third

    @cached_property
    def white(self) -> float:
        """What the filter along lines leaves of the variance of noise that is independent from pixel to pixel."""
        return float(np.sum(self.impulse**2))

    @cached_property
    def variance(self) -> NDArray[np.float64]:
        """Temporal variance of every pixel as read, e-^2, quantisation included, shape (row, col)."""
        step = 1.0 / float(self.camera.sensor.video.conversion_gain_dn_per_e)
        steady = self.white * (self.ccd.dark_e + self.ccd.read_noise_e**2) + step**2 / 12.0
        return self.expected * self.charge_e * (self.pulses[0] + self.white) + steady

    @cached_property
    def noise(self) -> NDArray[np.float64]:
        """Temporal noise of every pixel, in photoelectrons, shape (row, col)."""
        return np.sqrt(self.variance) / max(self.charge_e, 1e-300)

    def of_mean(self, change: NDArray[np.floating] | float) -> float:
        """Influence of a change of the mean, in photoelectrons."""
        return float(np.max(np.abs(change) / self.noise))

    def of_variance(self, part: NDArray[np.floating] | float) -> float:
        """Influence of a part of the variance, e-^2, on the standard deviation."""
        share = np.minimum(part / self.variance, 1.0)
        return float(np.max(1.0 - np.sqrt(1.0 - share)))

    def blurred(self, blur: Blur) -> NDArray[np.float64]:
        """The picture through a blur, going on beyond its edge as it ends there."""
        cells = self.camera.cells
        reach = 48
        wide = np.pad(self.expected, reach, mode="edge")
        fy = np.fft.fftfreq(wide.shape[0], cells.pitch_y_mm)[:, None]
        fx = np.fft.rfftfreq(wide.shape[1], cells.pitch_x_mm)[None, :]
        spectrum = np.fft.rfft2(wide) * product((blur,), *np.broadcast_arrays(fx, fy))
        return np.fft.irfft2(spectrum, wide.shape)[reach:-reach, reach:-reach]


def effects_of(picture: Picture) -> list[Effect]:
    """Return every optional effect with its influence on a picture."""
    influences = {**_light(picture), **_tube(picture), **_patterns(picture), **_detector(picture), **_video(picture)}
    millions = picture.expected.size / 1e6
    return [
        Effect(
            name=name,
            influence=influence,
            setup_s=SETUP_S.get(name, 0.0) * millions,
            frame_s=FRAME_S.get(name, 0.0) * millions,
        )
        for name, influence in influences.items()
    ]


def _light(picture: Picture) -> dict[str, float]:
    """What happens to light and photoelectrons before the gain."""
    camera, sensor, n = picture.camera, picture.camera.sensor, picture.expected
    cathode = sensor.photocathode
    scattered = Halo(fraction=1.0, gap_mm=float(cathode.gap_mm), elastic_share=float(cathode.halo_elastic_share))
    found = {
        "halo": float(cathode.halo_fraction) * picture.of_mean(picture.blurred(scattered) - n),
        "dark emission": picture.of_mean(picture.dark_pe),
        "bright-source protection": 0.0,
    }
    lux = float(picture.photoelectrons.mean()) / truth.field_pixel_area_cm2(camera) / camera.field_s
    lux /= photons.photoelectrons_per_lumen_s(sensor) * 1e-4
    blur = camera.bright_source_protection().blur(lux)
    if blur is not None:
        found["bright-source protection"] = picture.of_mean(picture.blurred(blur) - n)
    if camera.geometry:
        found["fibre geometry"] = picture.of_mean(_displaced(picture))
    return found


def _displaced(picture: Picture) -> NDArray[np.float64]:
    """How much a displacement by the fibres can change a pixel: no more than all that is in reach."""
    taper, ccd, n = picture.camera.sensor.taper, picture.camera.sensor.ccd, picture.expected
    rows, cols = n.shape
    y, x = np.mgrid[:rows, :cols]
    radius = np.hypot(y - 0.5 * (rows - 1), x - 0.5 * (cols - 1))
    corner = max(float(radius.max()), 1.0)
    stretched = 3.0 * abs(float(taper.distortion_fraction)) * (radius / corner) ** 2 * n
    shear = EXTREME * float(taper.shear_um) / min(float(ccd.pitch_x_um), float(ccd.pitch_y_um))
    far = abs(float(taper.distortion_fraction)) * corner + shear
    from scipy.ndimage import maximum_filter, minimum_filter

    reach = 2 * int(np.ceil(far)) + 1
    return stretched + maximum_filter(n, reach) - minimum_filter(n, reach)


def _tube(picture: Picture) -> dict[str, float]:
    plate, n = picture.plate, picture.expected
    load = picture.load
    found = {"plate saturation": picture.of_mean(n * load.mean())}
    if picture.camera.local_depletion:
        # Against the gain of the whole plate under its mean load.
        around = picture.blurred(_Neighbourhood(float(plate.depletion_blur_um or 0.0)))
        local = load.mean() * around / max(float(n.mean()), 1e-300)
        found["local depletion"] = picture.of_mean(n * (local - load.mean()) / (1.0 + local))
    rate = plate.ion_events_per_s_cm2 * plate.gate_s * truth.field_pixel_area_cm2(picture.camera)
    size = plate.ion_event_size_pe * picture.charge_e / plate.detection_probability
    second = picture.pulses[0] / max(picture.charge_e, 1e-300) * plate.detection_probability
    variance = rate * (size**2 + size * picture.charge_e / plate.detection_probability) * second
    found["ion events"] = picture.of_variance(variance) + picture.of_mean(
        rate * plate.ion_event_size_pe / plate.detection_probability
    )
    found["pulse-height law"] = _lopsided(picture)
    shares = picture.camera.afterglow(picture.conditions).pulse_shares
    together = float(np.mean(np.sum(shares[:, 1:] * shares[:, :-1], axis=1))) if shares.shape[1] > 1 else 0.0
    of_pulses = float(np.max(n * picture.charge_e * picture.pulses[0] / picture.variance))
    lost = 1.0 - float(np.mean(shares[:, 0] ** 2))
    found["afterglow"] = max(lost, together / float(np.mean(shares[:, 0] ** 2))) * of_pulses
    return found


def _lopsided(picture: Picture) -> float:
    """Influence of the pulse-height law's skewness where one pixel in a thousand lies (Cornish and Fisher)."""
    third = picture.expected * picture.charge_e * picture.pulses[1]
    return float(np.max(third / picture.variance**1.5)) * (ONE_IN_A_THOUSAND**2 - 1.0) / 6.0


def _patterns(picture: Picture) -> dict[str, float]:
    sensor = picture.camera.sensor
    lit = picture.of_mean(picture.expected)
    return {
        "multi-fibre pattern": float(sensor.microchannel_plate.pattern_contrast) * lit,
        "screen mottle": EXTREME * float(sensor.phosphor.gain_nonuniformity) * lit,
        "chicken wire": float(sensor.taper.pattern_contrast) * lit,
        "unequal pixels": EXTREME * float(sensor.ccd.prnu) * lit,
    }


def _detector(picture: Picture) -> dict[str, float]:
    ccd = picture.ccd
    per_pe = max(picture.charge_e, 1e-300)
    brightest = picture.unsaturated_e * picture.expected + 8.0 * np.sqrt(picture.variance)
    columns = picture.expected.sum(axis=0) * ccd.smear_fraction / (picture.expected.shape[0] / 10.0)
    return {
        "overflow": picture.of_mean(np.maximum(brightest - ccd.full_well_e, 0.0) / per_pe),
        "smear": picture.of_mean(columns),
        "dark pattern": picture.of_mean(EXTREME * ccd.dsnu_e / per_pe) if ccd.dark_e > 0.0 else 0.0,
        "dark charge": picture.of_variance(picture.white * ccd.dark_e),
        "read noise": picture.of_variance(picture.white * ccd.read_noise_e**2),
    }


def _video(picture: Picture) -> dict[str, float]:
    video = picture.camera.video()
    if not isinstance(video, Video):
        return {}
    gain = video.conversion_gain_dn_per_e
    slope = np.abs(np.gradient(picture.expected, axis=1)) if picture.expected.shape[1] > 1 else np.zeros(1)
    return {
        "sync jitter": picture.of_variance((video.sync_jitter_px * slope * picture.charge_e) ** 2),
        "line noise": picture.of_variance((video.line_noise_dn / gain) ** 2),
    }


@dataclass(frozen=True)
class _Neighbourhood:
    """Gaussian neighbourhood of channels whose output counts."""

    sigma_um: float

    def transfer(self, fx_per_mm: NDArray[np.floating], fy_per_mm: NDArray[np.floating]) -> NDArray[np.floating]:
        squared = fx_per_mm**2 + fy_per_mm**2
        return np.exp(-2.0 * (np.pi * self.sigma_um * 1e-3) ** 2 * squared)


def planned(
    camera: IntensifiedCamera, freed: Light, conditions: Conditions, tolerance: float = DEFAULT_TOLERANCE
) -> tuple[IntensifiedCamera, Plan]:
    """Return the camera without what this light does not need, and the plan that says so.

    Parameters
    ----------
    camera
        The camera, nothing left out.
    freed
        Photoelectrons that light frees from the cathode, per cell of `camera.scene_cells` and exposure.
    conditions
        Gate, voltage and temperature.
    tolerance
        What may change, as a share of the temporal noise of each pixel.
    """
    plan = plan_of(effects_of(Picture(camera, per_pixel(camera, freed), conditions)), tolerance)
    return replace(camera, left_out=plan.names), plan


def per_pixel(camera: IntensifiedCamera, freed: Light) -> NDArray[np.float64]:
    """Return photoelectrons per pixel as read, shape (row, col), of those per cell of `camera.scene_cells`."""
    cells = camera.scene_cells
    rows, cols = cells.shape[0] // cells.per_row, cells.shape[1] // cells.per_column
    chip = freed.values.reshape(rows, cells.per_row, cols, cells.per_column).sum(axis=(1, 3), dtype=float)
    chip = chip[cells.margin_rows :, cells.margin_columns :][: cells.rows, : cells.columns]
    return chip[:-1] + chip[1:] if camera.interlaced else chip
