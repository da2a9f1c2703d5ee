"""What each effect of the intensified camera can change in a picture at most, as a share of the temporal noise there.

Estimates are bounds made from the expected picture in photoelectrons and the camera's numbers: no frame is drawn and no
stage is run. Three statistics of every pixel count, and an effect's influence is the largest change of any of them: the
mean, in units of the temporal noise; the temporal noise itself, relative; and, where the law of the noise changes its
shape, the level that one frame in a thousand exceeds, in units of the noise. Each of the three changes by no more than
the sum of what the effects left out change, so the sum of influences bounds them all.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from labdata.conditions import Conditions
from labdata.errors import BadInput
from simulate.economy import DEFAULT_TOLERANCE, Effect, Plan, plan_of
from simulate.iiccd import photons, truth
from simulate.iiccd.automatic import AutomaticState
from simulate.iiccd.camera import DRAW_MARGIN_PX, SCENE_MARGIN_PX, IntensifiedCamera
from simulate.iiccd.ccd import Ccd
from simulate.iiccd.light import Light, product
from simulate.iiccd.microchannel import MicrochannelPlate
from simulate.iiccd.pattern import MOTTLE_MM
from simulate.iiccd.streamed.kernel import noise_kernel
from simulate.iiccd.streamed.prepare import SHORTEST_TAP, SKEWNESS_TOLERANCE, SPARSE_PE_PER_PX, Stages
from simulate.iiccd.transfer import Blur, Halo
from simulate.iiccd.video import Video

# Chance that the largest of a pattern's random numbers lies beyond the one that bounds take.
MISSED = 0.1
# Level that one normal number in a thousand exceeds.
ONE_IN_A_THOUSAND = 3.09
# Wells are taken to overflow if a pixel's charge lies so many standard deviations below its full well.
OVERFLOW_SD = 8.0
# Rings in which the displacement by the fibres is bounded by that of their outer edge.
RINGS = 6
# Steepest growth of the variance of rounded numbers with that of what is rounded, times the latter in steps^2: the
# largest of x phi(x) (1 - 2 Phi(-x)) / 2.
ROUNDING = 0.09
# Seconds that effects cost for a million pixels, once and a frame, as `python -m benchmarks.economy --costs` measures
# them: medians, which scatter by some 0.05 s and 0.5 ms; what is not here costs less than that.
SETUP_S = {
    "pulse-height law": 1.5,
    "fibre geometry": 0.6,
    "local depletion": 0.25,
    "screen mottle": 0.15,
    "plate saturation": 0.15,
    "afterglow": 0.1,
    "multi-fibre pattern": 0.1,
}
FRAME_S = {"overflow": 5.3e-3, "pulse-height law": 2.9e-3, "afterglow": 1.9e-3, "dark pattern": 0.7e-3}

Map = NDArray[np.floating]
UNTOUCHED = AutomaticState()


@dataclass(frozen=True)
class Picture:
    """The picture that a camera is about to take, as a bound needs it.

    Parameters
    ----------
    camera
        The camera, nothing left out.
    photoelectrons
        Photoelectrons that light frees per pixel as read and exposure, in the frame and in the margin around it, see
        `per_pixel`, shape (row, col).
    conditions
        Gate, voltage and temperature.
    tolerance
        What may change in all, as a share of the temporal noise. Variances do not add like standard deviations: how
        much a share of the variance counts depends on how much may be left out.
    state
        Where the automatic controls stand.
    """

    camera: IntensifiedCamera
    photoelectrons: Map
    conditions: Conditions
    tolerance: float = DEFAULT_TOLERANCE
    state: AutomaticState = UNTOUCHED

    def __post_init__(self) -> None:
        if self.camera.left_out:
            raise BadInput(f"a plan must begin with all effects, got a camera without {sorted(self.camera.left_out)}")

    @cached_property
    def stages(self) -> Stages:
        """The camera's stages."""
        return Stages.of(self.camera.chain(self.conditions), self.camera.fields_per_frame)

    @cached_property
    def plate(self) -> MicrochannelPlate:
        """The plate, with the brightness control where it stands."""
        plate = self.camera.plate(self.conditions)
        return replace(plate, gain=plate.gain * self.state.brightness)

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
    def surroundings(self) -> Map:
        """Photoelectrons per pixel and exposure, dark ones included, in the frame and in the margin around it."""
        return np.asarray(self.photoelectrons, np.float64) + self.dark_pe

    def frame_of(self, wide: Map, margin: int = 0) -> Map:
        """Cut the frame out of a map that has the margin, leaving so many pixels of it on every side."""
        first, (rows, cols) = SCENE_MARGIN_PX - margin, self.camera.shape
        return wide[first : first + rows + 2 * margin, first : first + cols + 2 * margin]

    @cached_property
    def expected(self) -> Map:
        """Photoelectrons per pixel and exposure, dark ones included, shape (row, col)."""
        return self.frame_of(self.surroundings)

    @cached_property
    def unsaturated_e(self) -> float:
        """CCD electrons per photoelectron of a plate at rest."""
        sensor = self.camera.sensor
        optical = float(sensor.phosphor.photons_per_electron) * float(sensor.taper.transmission)
        behind = optical * self.ccd.quantum_efficiency
        return self.plate.gain * behind

    def load(self, photoelectrons: Map) -> Map:
        """Output of the plate at rest over its saturating output, of photoelectrons per pixel and exposure."""
        area = truth.field_pixel_area_cm2(self.camera)
        per_pe = self.plate.gain / area / self.plate.field_s / self.plate.saturation_e_per_s_cm2
        return np.asarray(photoelectrons * per_pe)

    @cached_property
    def mean_load(self) -> float:
        """Load of the whole plate as far as it is drawn."""
        return float(self.load(self.frame_of(self.surroundings, DRAW_MARGIN_PX)).mean())

    @cached_property
    def charge_e(self) -> float:
        """CCD electrons per photoelectron under the mean load."""
        return max(self.unsaturated_e / (1.0 + self.mean_load), 1e-300)

    @cached_property
    def impulse(self) -> Map:
        """Impulse response along a line."""
        return np.asarray(self.camera.video().low_pass.impulse_response(), float)

    @cached_property
    def blurs(self) -> tuple[float, float]:
        """What blur behind the gain leaves of a pulse's second and third moment, dimensionless.

        The kernel is the one that frames will be drawn with, so that it is worked out once.
        """
        owed = self.stages.behind_plate.mean(Light(values=np.zeros((1, 1), np.float32))).owed
        taps = self.impulse[: np.flatnonzero(np.abs(self.impulse) > SHORTEST_TAP)[-1] + 1]
        sparse = float(self.frame_of(self.surroundings, DRAW_MARGIN_PX).mean()) < SPARSE_PE_PER_PX
        height, impulse = 2 if self.camera.interlaced else 1, tuple(float(tap) for tap in taps)
        kernel = noise_kernel(owed, self.camera.cells, height, impulse, SKEWNESS_TOLERANCE, sparse=sparse)
        return kernel.blur_factor, kernel.third_factor

    @cached_property
    def shares(self) -> Map:
        """Shares of a pulse's light that come out in its own field and in later ones, shape (pulse, field)."""
        return self.camera.afterglow(self.conditions).pulse_shares

    @cached_property
    def decay(self) -> tuple[float, float]:
        """What the screen's decay leaves of a pulse's second and third moment: a field shows earlier ones as well."""
        return float(np.mean(np.sum(self.shares**2, axis=1))), float(np.mean(np.sum(self.shares**3, axis=1)))

    @cached_property
    def pulse_e(self) -> float:
        """CCD electrons of one mean pulse."""
        return self.charge_e / self.plate.detection_probability

    @cached_property
    def pulses(self) -> tuple[float, float]:
        """Second and third moment of one photoelectron's share of a pixel, over the first moment, e- and e-^2."""
        wider = 1.0 + 1.0 / self.plate.pulse_height_shape
        second = self.pulse_e * wider * self.blurs[0] * self.decay[0]
        third = self.pulse_e**2 * wider * (wider + 1.0 / self.plate.pulse_height_shape) * self.blurs[1] * self.decay[1]
        return second, third

    @cached_property
    def white(self) -> float:
        """What the filter along lines leaves of the variance of noise that is independent from pixel to pixel."""
        return float(np.sum(self.impulse**2))

    @cached_property
    def step_e(self) -> float:
        """One step of the digitiser, e-; of a curved characteristic the finest, none."""
        video = self.camera.sensor.video
        gain = float(video.conversion_gain_dn_per_e) * self.state.gain
        return 1.0 / gain if float(video.gamma) == 1.0 else 0.0

    @cached_property
    def line_noise_e(self) -> float:
        """Offset common to a line, e-."""
        video = self.camera.video()
        return video.line_noise_dn * self.step_e if isinstance(video, Video) else 0.0

    @cached_property
    def electronics(self) -> float:
        """Variance of all noise that is there without light, e-^2."""
        return self.white * (self.ccd.dark_e + self.ccd.read_noise_e**2) + self.line_noise_e**2

    @cached_property
    def of_pulses(self) -> Map:
        """Temporal variance that pulses, those of ions among them, bring to every pixel, e-^2, shape (row, col)."""
        return self.expected * self.charge_e * (self.pulses[0] + self.white) + self.of_ions

    @cached_property
    def ions(self) -> float:
        """Ion events per pixel and exposure."""
        return self.plate.ion_events_per_s_cm2 * self.plate.gate_s * truth.field_pixel_area_cm2(self.camera)

    @cached_property
    def of_ions(self) -> float:
        """Temporal variance that ion events bring, e-^2: a Poisson number of pulses each."""
        size = self.plate.ion_event_size_pe
        squared = self.pulse_e**2 * (size**2 + size * (1.0 + 1.0 / self.plate.pulse_height_shape))
        return self.ions * squared * self.blurs[0] * self.decay[0]

    @cached_property
    def variance(self) -> Map:
        """Temporal variance of every pixel as read, e-^2, rounding included, shape (row, col)."""
        return self.of_pulses + self.electronics + self.step_e**2 / 12.0 + 1e-12

    @cached_property
    def noise(self) -> Map:
        """Temporal noise of every pixel, in photoelectrons, shape (row, col)."""
        return np.sqrt(self.variance) / self.charge_e

    @cached_property
    def smear(self) -> Map:
        """Photoelectrons' worth of charge that smear adds to every pixel of a column, shape (col,)."""
        return self.expected.sum(axis=0) * self.ccd.smear_fraction / (self.expected.shape[0] / 10.0)

    @cached_property
    def brightest_e(self) -> Map:
        """Charge that hardly any frame exceeds, e-, shape (row, col); the plate is nowhere brighter than at rest."""
        charge = self.unsaturated_e * (self.expected + self.smear) + self.ccd.dark_e + self.hottest_e
        return charge + OVERFLOW_SD * np.sqrt(self.variance)

    @cached_property
    def hottest_e(self) -> float:
        """How far a pixel's dark charge lies off the mean at most, e-: a gamma law's extremes, the hot or the cold."""
        from scipy.special import gammainccinv, gammaincinv

        missed = MISSED / self.expected.size
        if self.ccd.dsnu_e == 0.0 or self.ccd.dark_e == 0.0:
            return 0.0
        shape = (self.ccd.dark_e / self.ccd.dsnu_e) ** 2
        hottest, coldest = gammainccinv(shape, missed) / shape, gammaincinv(shape, missed) / shape
        return self.ccd.dark_e * float(max(hottest - 1.0, 1.0 - coldest))

    @cached_property
    def running(self) -> NDArray[np.bool_]:
        """Columns in which charge may run over that no drain carries off, shape (col,)."""
        limit = self.ccd.full_well_e * max(self.ccd.antibloom_ratio, 1.0)
        return np.asarray(self.brightest_e.max(axis=0) > limit)

    @cached_property
    def quiet(self) -> Map:
        """Variance of every pixel, e-^2, where it may be full that of reading alone: a full well has no noise."""
        reading = self.white * self.ccd.read_noise_e**2 + self.line_noise_e**2 + self.step_e**2 / 12.0 + 1e-12
        full = (self.brightest_e > self.ccd.full_well_e) | self.running
        return np.where(full, reading, self.variance)

    @property
    def dropped(self) -> float:
        """Largest share of the variance that the tolerance lets go."""
        return self.tolerance / (1.0 + self.tolerance)

    def of_mean(self, change: Map | float) -> float:
        """Influence of a change of the mean that leaves the noise as it is, in photoelectrons.

        Notes
        -----
        What wells cannot take and drains do not carry off runs along its column: more charge anywhere in it can then
        raise any one pixel by as much as all the column gains, and no more (Diaconis and Fulton, Rend. Sem. Mat. Torino
        49, 95, 1991).
        """
        size = np.broadcast_to(np.abs(change), self.noise.shape)
        together = size.sum(axis=0)[self.running] / self.noise.min(axis=0)[self.running]
        return float(max(np.max(size / self.noise), np.max(together, initial=0.0)))

    def of_light(self, change: Map | float) -> float:
        """Influence of more or less light, in photoelectrons per pixel: its mean, and the noise of its pulses.

        Notes
        -----
        Where light is sparse the noise tells more of it than the mean: a standard deviation follows half the relative
        change of the light, whereas the mean changes by a share of the noise that falls with the root of the light.
        """
        noise = np.abs(change) * self.charge_e * (self.pulses[0] + self.white)
        return max(self.of_mean(change), self.of_variance(noise))

    def of_gain(self, relative: Map | float) -> float:
        """Influence of a relative change of the gain: of the mean and of the noise of the pulses alike."""
        change = np.abs(relative)
        return max(self.of_mean(change * self.expected), float(np.max(change * self.of_pulses / self.variance)))

    def of_variance(self, part: Map | float) -> float:
        """Influence of a part of the variance, e-^2, that has the correlations of the rest.

        Notes
        -----
        Without a share s the standard deviation falls by 1 - sqrt(1 - s), which grows faster than s: shares that are
        left out together count more than each alone. s/(2 - T) adds up, and reaches the tolerance T just where the
        standard deviation has fallen by T.
        """
        return float(np.max(part / self.variance)) / (2.0 - min(self.tolerance, 1.0))

    def of_white(self, part: Map | float) -> float:
        """Influence of a part of the variance, e-^2, whose correlations differ from those of the rest.

        Notes
        -----
        Without a share s of the variance, correlations rise from r to r/(1 - s) at most, or fall as much: s (1 + T)
        adds up, and reaches T just where s/(1 - s) does. Where noise is smaller than a step of the digitiser, the
        variance of the codes follows it more steeply, by up to `ROUNDING` over its variance in steps^2 where the mean
        lies as unluckily as it can.
        """
        steeper = ROUNDING * self.step_e**2 / max(self.electronics, 1e-300)
        return float(np.max(np.minimum(part / self.quiet, 1.0))) * max(1.0, steeper) * (1.0 + self.tolerance)

    def blurred(self, blur: Blur) -> Map:
        """The picture through a blur, its surroundings taking part."""
        cells, wide = self.camera.cells, self.surroundings
        fy = np.fft.fftfreq(wide.shape[0], cells.pitch_y_mm)[:, None]
        fx = np.fft.rfftfreq(wide.shape[1], cells.pitch_x_mm)[None, :]
        spectrum = np.fft.rfft2(wide) * product((blur,), *np.broadcast_arrays(fx, fy))
        return np.asarray(self.frame_of(np.fft.irfft2(spectrum, wide.shape)))


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
        "halo": float(cathode.halo_fraction) * picture.of_light(picture.blurred(scattered) - n),
        "dark emission": picture.of_light(picture.dark_pe) + _lopsided(picture, picture.dark_pe),
        "bright-source protection": 0.0,
    }
    lux = float(picture.photoelectrons.mean()) / truth.field_pixel_area_cm2(camera) / camera.field_s
    lux /= photons.photoelectrons_per_lumen_s(sensor) * 1e-4
    blur = camera.bright_source_protection().blur(lux)
    if blur is not None:
        found["bright-source protection"] = picture.of_light(picture.blurred(blur) - n)
    if camera.geometry:
        found["fibre geometry"] = picture.of_light(_displaced(picture))
    return found


def _displaced(picture: Picture) -> Map:
    """How much a displacement by the fibres can change a pixel: no more than all that is in reach.

    Notes
    -----
    Distortion by D (r/R)^2 moves light by D r^3/R^2 and stretches areas by the factor (1 + D s^2)(1 + 3 D s^2), about
    4 D s^2 with s = r/R. A multi-fibre is off by half the root mean square by which neighbours differ, in x and in y.
    """
    from scipy.ndimage import maximum_filter, minimum_filter

    taper, cells, wide = picture.camera.sensor.taper, picture.camera.cells, picture.surroundings
    distortion = abs(float(taper.distortion_fraction))
    rows, cols = wide.shape
    y = (np.arange(rows) - SCENE_MARGIN_PX - 0.5 * (picture.camera.shape[0] - 1)) * cells.pitch_y_mm
    x = (np.arange(cols) - SCENE_MARGIN_PX - 0.5 * (picture.camera.shape[1] - 1)) * cells.pitch_x_mm
    corner_mm = 0.5 * np.hypot(cells.rows * cells.pitch_y_mm, cells.columns * cells.pitch_x_mm)
    place = picture.frame_of(np.hypot(y[:, None], x[None, :])) / corner_mm
    hexagons = wide.size * cells.pitch_x_mm * cells.pitch_y_mm / (float(taper.pattern_pitch_um) * 1e-3) ** 2
    shear_mm = 0.5 * extreme(2.0 * hexagons) * float(taper.shear_um) * 1e-3 * float(taper.demagnification)
    stretch = (1.0 + distortion * place**2) * (1.0 + 3.0 * distortion * place**2) - 1.0
    change = np.zeros(picture.expected.shape)
    for ring in range(RINGS):
        inner, outer = ring / RINGS, (ring + 1) / RINGS
        far_mm = distortion * outer**3 * corner_mm + shear_mm
        reach = [2 * int(np.ceil(far_mm / pitch)) + 1 for pitch in (cells.pitch_y_mm, cells.pitch_x_mm)]
        span = picture.frame_of(maximum_filter(wide, reach) - minimum_filter(wide, reach))
        here = (place >= inner) & ((place < outer) | (ring == RINGS - 1))
        change[here] = span[here]
    return change + stretch * picture.expected


def extreme(count: float) -> float:
    """Return what the largest of so many normal numbers stays below but for a chance of `MISSED`, in their sd."""
    from scipy.special import ndtri

    return float(-ndtri(MISSED / max(count, 1.0)))


def _tube(picture: Picture) -> dict[str, float]:
    found = _saturation(picture)
    found["ion events"] = _ions(picture)
    found["pulse-height law"] = _lopsided(picture, picture.expected)
    found["afterglow"] = _afterglow(picture)
    return found


def _saturation(picture: Picture) -> dict[str, float]:
    """A plate that is loaded, as a whole and place by place; without saturation there is no local one either."""
    mean = picture.mean_load
    found = {"plate saturation": picture.of_gain(mean)}
    if picture.camera.local_depletion:
        neighbourhood = _Neighbourhood(float(picture.plate.depletion_blur_um or 0.0))
        local = np.maximum(picture.load(picture.blurred(neighbourhood)), 0.0)
        # Relative to whichever gain is the lower.
        found["local depletion"] = picture.of_gain((local - mean) / (1.0 + np.minimum(local, mean)))
        found["plate saturation"] = max(found["plate saturation"], picture.of_gain(local))
    return found


def _ions(picture: Picture) -> float:
    """Rare bright events: their mean, their variance, and how far they push the level of one frame in a thousand.

    Notes
    -----
    An event is seen by as many pixels as its light is spread over, about three times the reciprocal of what blur leaves
    of the variance, in as many fields as the screen remembers. A chance p of that shifts the level that normal noise
    exceeds with a chance q by p/(q z).
    """
    pixels, fields = 3.0 / picture.blurs[0], 1 + int(np.sum(picture.shares.mean(axis=0)[1:] > 0.01))
    pushed = min(picture.ions * pixels * fields / 1e-3 / ONE_IN_A_THOUSAND, 1.0)
    mean = picture.of_mean(picture.ions * picture.plate.ion_event_size_pe / picture.plate.detection_probability)
    return max(picture.of_variance(picture.of_ions) + mean, pushed)


def _lopsided(picture: Picture, photoelectrons: Map | float) -> float:
    """Influence of the skewness that pulses of so many photoelectrons bring, where one frame in a thousand lies.

    Notes
    -----
    Cornish and Fisher: the level lies (z^2 - 1)/6 skewnesses higher; counted with the least noise that the tolerance
    leaves.
    """
    third = photoelectrons * picture.charge_e * picture.pulses[1]
    least = picture.variance * (1.0 - picture.dropped)
    return float(np.max(third / least**1.5)) * (ONE_IN_A_THOUSAND**2 - 1.0) / 6.0


def _afterglow(picture: Picture) -> float:
    """A screen that does not remember: more noise in every field, as nothing is averaged, and no likeness of fields."""
    share = float(np.max(picture.of_pulses / picture.variance))
    second, third = picture.decay
    together = float(np.mean(np.sum(picture.shares[:, 1:] * picture.shares[:, :-1], axis=1))) / second
    grown = np.sqrt(1.0 + share * (1.0 / second - 1.0)) - 1.0
    skewed = _lopsided(picture, picture.expected) * abs(1.0 - second**1.5 / third)
    return max(float(grown) + skewed, together * share)


def _patterns(picture: Picture) -> dict[str, float]:
    sensor, cells = picture.camera.sensor, picture.camera.cells
    pixels = float(picture.expected.size)
    grains = pixels * cells.pitch_x_mm * cells.pitch_y_mm / MOTTLE_MM**2
    lit = picture.of_gain(1.0)
    return {
        "multi-fibre pattern": float(sensor.microchannel_plate.pattern_contrast) * lit,
        "screen mottle": extreme(2.0 * grains) * float(sensor.phosphor.gain_nonuniformity) * lit,
        "chicken wire": float(sensor.taper.pattern_contrast) * lit,
        "unequal pixels": extreme(2.0 * pixels) * float(sensor.ccd.prnu) * lit,
    }


def _detector(picture: Picture) -> dict[str, float]:
    ccd = picture.ccd
    beyond = np.maximum(picture.brightest_e - ccd.full_well_e, 0.0)
    pattern = _dark_pattern(picture)
    return {
        "overflow": picture.of_mean(beyond / picture.charge_e),
        "smear": picture.of_mean(picture.smear),
        "dark pattern": pattern,
        # Without dark charge there is no pattern of it.
        "dark charge": picture.of_white(picture.white * ccd.dark_e) + pattern,
        "read noise": picture.of_white(picture.white * ccd.read_noise_e**2),
    }


def _dark_pattern(picture: Picture) -> float:
    """Pixels that are darker or hotter than others: their mean and their noise."""
    off = picture.hottest_e
    return max(picture.of_mean(off / picture.charge_e), picture.of_white(picture.white * off))


def _video(picture: Picture) -> dict[str, float]:
    video = picture.camera.video()
    if not isinstance(video, Video):
        return {}
    n, late = picture.expected, video.sync_jitter_px
    beside = np.pad(n, ((0, 0), (1, 1)), mode="edge")
    left, right = n - beside[:, :-2], beside[:, 2:] - n
    steepest = np.maximum(np.abs(left), np.abs(right))
    moved = picture.of_white((late * steepest * picture.charge_e) ** 2)
    # A shift within a pixel averages neighbours: the variance of white noise falls by 3/2 late^2.
    averaged = picture.of_white(1.5 * late**2 * picture.variance)
    return {
        "sync jitter": max(moved + averaged, picture.of_mean(0.5 * late**2 * (right - left))),
        "line noise": picture.of_white(picture.line_noise_e**2),
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
        Gate, voltage and temperature, and which automatic controls were on.
    tolerance
        What may change, as a share of the temporal noise of each pixel.

    Notes
    -----
    Controls that are on pass from where they start to where they settle; an effect counts as it does at the worse end.
    """
    untouched = Picture(camera, per_pixel(camera, freed), conditions, tolerance)
    ends = (effects_of(replace(untouched, state=state)) for state in _ends(untouched))
    plan = plan_of(_worst(ends), tolerance)
    return replace(camera, left_out=plan.names), plan


def _ends(picture: Picture) -> Iterable[AutomaticState]:
    """Where the automatic controls start, and the farthest they may go."""
    yield UNTOUCHED
    camera, conditions = picture.camera, picture.conditions
    control, gain = camera.brightness_control(conditions), camera.automatic_gain(conditions)
    if control is None and gain is None:
        return
    brightness = 1.0
    if control is not None:
        n = float(picture.frame_of(picture.surroundings, DRAW_MARGIN_PX).mean())
        output = picture.plate.gain * n / truth.field_pixel_area_cm2(camera) / picture.plate.field_s
        brightness = min(1.0, control.limit_e_per_s_cm2 / max(output, 1e-300))
    yield AutomaticState(brightness=brightness)
    if gain is not None:
        yield AutomaticState(gain=gain.highest)
        yield AutomaticState(brightness=brightness, gain=gain.highest)


def _worst(ends: Iterable[list[Effect]]) -> list[Effect]:
    """Every effect with the largest of its influences."""
    return [max(same, key=lambda effect: effect.influence) for same in zip(*ends, strict=True)]


def per_pixel(camera: IntensifiedCamera, freed: Light) -> Map:
    """Return photoelectrons per pixel as read, of those per cell of `camera.scene_cells`.

    Returns
    -------
    NDArray
        The frame and the margin of `SCENE_MARGIN_PX` or more around it, shape (row, col).
    """
    cells = camera.scene_cells
    rows, cols = cells.shape[0] // cells.per_row, cells.shape[1] // cells.per_column
    chip = freed.values.reshape(rows, cells.per_row, cols, cells.per_column).sum(axis=(1, 3), dtype=float)
    # Field integration sums rows; the last row of the margin has none below it.
    return chip + np.append(chip[1:], chip[-1:], axis=0) if camera.interlaced else chip
