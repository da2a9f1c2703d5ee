"""MTF of each stage of an intensified camera, from the parameters of a description.

Lens, halo, tube and taper are isotropic; pixel and video differ between rows and columns.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

from charact.estimators.mtf.session.thresholds import THRESHOLDS
from charact.transfer.extended import halo
from charact.transfer.stages import fibres, lens
from charact.transfer.video_filter import sampled_response, transfer
from labdata import Array
from labdata.camera.description import Camera
from labdata.camera.parameters import Parameter

Direction = Literal["horizontal", "vertical"]

STAGES = ("lens", "halo", "tube before the gain", "tube after the gain", "taper", "pixel", "video")
AFTER_GAIN = STAGES[3:]
# Parameters of the description that are fitted, with unit and bounds.
PARAMETERS: dict[str, tuple[str, tuple[float, float]]] = {
    "optics.aberration_blur_um": ("um", (0.0, 40.0)),
    "photocathode.halo_fraction": ("1", (0.0, 0.5)),
    "photocathode.halo_elastic_share": ("1", (0.0, 1.0)),
    "photocathode.gap_mm": ("mm", (0.02, 2.0)),
    "tube.mtf_frequency_lp_per_mm": ("lp/mm", (5.0, 120.0)),
    "tube.mtf_exponent": ("1", (0.7, 2.5)),
    "tube.post_gain_share": ("1", (0.0, 1.0)),
    "taper.interface_mtf_lp_per_mm": ("lp/mm", (20.0, 400.0)),
    "video.bandwidth_mhz": ("MHz", (2.0, 20.0)),
}
HALO = tuple(name for name in PARAMETERS if name.startswith("photocathode."))
# Bandwidths at which the video's transfer is tabulated, MHz.
BANDWIDTHS_MHZ = np.geomspace(2.0, 20.0, 120)


@dataclass(frozen=True, kw_only=True)
class StageModel:
    """Geometry of a camera, and names, means and standard deviations of the priors of the fitted
    parameters.

    Notes
    -----
    At the cathode: lens exp(-2 (pi f s)^2) times diffraction, halo (1 - q) + q H(f), tube
    exp(-(f/fc)^n), of whose exponent a share acts after the gain. At the detector: fibres 2 J1(pi p
    f)/(pi p f) and their interfaces exp(-(f/f0)^2), pixel sinc, and video, a Butterworth low pass
    of the register's stairs, read once a clock.
    """

    sensor: Camera
    rows_summed: float
    names: tuple[str, ...]
    mean: Array
    sd: Array

    @classmethod
    def of(cls, sensor: Camera, *, interlaced: bool, halo: bool) -> "StageModel":
        """Return the model of a description; `halo`: whether the curves are normalised to all
        light.
        """
        known = sensor.parameters()
        names = tuple(name for name in PARAMETERS if name in known and (halo or name not in HALO))
        return cls(
            sensor=sensor,
            rows_summed=2.0 if interlaced else 1.0,
            names=names,
            mean=np.array([float(known[name]) for name in names]),
            sd=np.array([prior_sd_of(known[name]) for name in names]),
        )

    @property
    def bounds(self) -> Array:
        """Bounds of the parameters, shape (parameter, 2)."""
        return np.array([PARAMETERS[name][1] for name in self.names])

    @property
    def stages(self) -> tuple[str, ...]:
        """All stages; without the halo where there is none."""
        return tuple(stage for stage in STAGES if stage != "halo" or HALO[0] in self.names)

    def mtf(
        self, theta: Array, frequency: Array, direction: Direction, *, after_gain: bool = False
    ) -> Array:
        """Return the product of all stages, or of those after the gain, shape (n, frequency)."""
        logs = self.log_stages(theta, np.asarray(frequency, float), direction)
        return np.exp(np.sum(logs[STAGES.index(AFTER_GAIN[0]) :] if after_gain else logs, axis=0))

    def log_stages(self, theta: Array, frequency: Array, direction: Direction) -> Array:
        """Return ln of the MTF of each stage, shape (stage, n, frequency), frequencies per pitch of
        the direction.
        """
        ccd, taper = self.sensor.ccd, self.sensor.taper
        get = {name: theta[:, i, None] for i, name in enumerate(self.names)}
        along = direction == "horizontal"
        detector = frequency / float(ccd.pitch_x_um if along else ccd.pitch_y_um) * 1e3
        cathode = detector / float(taper.demagnification)
        cut_off = get["tube.mtf_frequency_lp_per_mm"]
        tube = -np.exp(get["tube.mtf_exponent"] * np.log(np.maximum(cathode, 1e-9) / cut_off))
        post_gain_share = get["tube.post_gain_share"]
        interface = get["taper.interface_mtf_lp_per_mm"]
        taper_fibres = fibres(detector, float(taper.fibre_pitch_um) * 1e-3, interface)
        optics = lens(
            cathode,
            get["optics.aberration_blur_um"],
            float(self.sensor.optics.f_number),
            THRESHOLDS.wavelength_mm * 1e6,
        )
        pixel = np.abs(np.sinc(frequency * (1.0 if along else self.rows_summed)))
        none = np.zeros((len(theta), len(frequency)))
        return np.stack(
            [
                np.log(np.maximum(optics, 1e-12)),
                none + self._log_halo(get, cathode),
                (1.0 - post_gain_share) * tube,
                post_gain_share * tube,
                np.log(np.maximum(taper_fibres, 1e-12)),
                none + np.log(np.maximum(pixel, 1e-12)),
                none + (self._log_video(get, frequency) if along else 0.0),
            ]
        )

    def _log_halo(self, get: dict[str, Array], cathode: Array) -> Array | float:
        """Return ln of (1 - q) + q times the transfer of a halo four gaps wide."""
        if HALO[0] not in get:
            return 0.0
        fraction, elastic, gap_mm = (get[name] for name in HALO)
        return np.log1p(fraction * (halo(4.0 * np.pi * gap_mm * cathode, elastic) - 1.0))

    def _log_video(self, get: dict[str, Array], frequency: Array) -> Array | float:
        """Return ln of the transfer of the video, interpolated in bandwidth."""
        if "video.bandwidth_mhz" not in get:
            return 0.0
        video = self.sensor.video
        assert video.pixel_clock_mhz is not None and video.filter_order is not None
        table = _video_table(
            tuple(frequency.tolist()), float(video.pixel_clock_mhz), video.filter_order
        )
        position = np.interp(
            get["video.bandwidth_mhz"][:, 0], BANDWIDTHS_MHZ, np.arange(len(BANDWIDTHS_MHZ))
        )
        node = np.minimum(position.astype(int), len(BANDWIDTHS_MHZ) - 2)
        part = (position - node)[:, None]
        return (1.0 - part) * table[node] + part * table[node + 1]


@lru_cache(maxsize=32)
def _video_table(frequency: tuple[float, ...], clock_mhz: float, order: int) -> Array:
    """Return ln of the video's transfer at every tabulated bandwidth, shape (bandwidth,
    frequency).
    """
    weights = sampled_response(BANDWIDTHS_MHZ, clock_mhz, order)
    return np.log(np.abs(transfer(weights, np.array(frequency))))


def prior_sd_of(parameter: Parameter) -> float:
    """Return the prior standard deviation, a quarter of the 95 % range."""
    if parameter.low is None or parameter.high is None or parameter.high == parameter.low:
        return THRESHOLDS.unstated_sd * max(abs(float(parameter)), 1e-3)
    return (parameter.high - parameter.low) / 3.92
