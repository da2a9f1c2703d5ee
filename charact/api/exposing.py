"""Exposure that reaches a signal-to-noise ratio with a described camera."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from charact.api.inputs import camera_of
from labdata.errors import BadInput
from labdata.settings import Argument, Setting, documented

if TYPE_CHECKING:
    from labdata import Camera

LAMP_K = 2856.0  # colour temperature at which tubes are specified
# Bands of the light, nm: all that photocathodes, silicon and the eye detect.
FIRST_NM, LAST_NM, BAND_NM = 360, 1100, 10


@dataclass(frozen=True, kw_only=True)
class Exposure:
    """Settings that reach a signal-to-noise ratio, and what they give."""

    camera: str  #: Name of the camera
    frames: int  #: Number of frames whose mean has the ratio
    frames95: tuple[int, int] | None  #: 95 % interval of the number that is needed
    gate_s: float  #: Gate of a tube, or exposure of a camera without one, s
    mcp_v: float | None  #: Voltage across the microchannel plate, V
    em_gain: float | None  #: Multiplication of a register
    snr: float  #: Ratio of the mean of all frames, per pixel
    snr_interval95: tuple[float, float] | None  #: Its 95 % interval by the posterior, if any
    snr_of_a_frame: float  #: Ratio of one frame
    signal_dn: float  #: Signal of the light, DN
    noise_dn: float  #: Temporal noise of a pixel of one frame, DN
    detector_lux: float  #: 2856 K light on photocathode or chip that gives this signal, lux
    #: What the settings load, by name with its unit, and the most that it takes
    loads: dict[str, tuple[float, float]]
    screen_c_per_cm2: float | None  #: Charge through the screen by all frames, C/cm2
    notes: tuple[str, ...]  #: What was assumed, and warnings

    def __str__(self) -> str:
        gains = ((", MCP {:.0f} V", self.mcp_v), (", EM gain {:.3g}", self.em_gain))
        gain = "".join(text.format(value) for text, value in gains if value is not None)
        interval = "" if self.snr_interval95 is None else " ({:.3g} to {:.3g}, 95 %)"
        several = "" if self.frames95 is None else " ({} to {}, 95 %)"
        lines = [
            f"{self.camera}: {'exposure' if self.mcp_v is None else 'gate'} "
            f"{1e3 * self.gate_s:.4g} ms{gain}, frames {self.frames}"
            + several.format(*self.frames95 or ()),
            f"SNR of a pixel {self.snr:.3g}{interval.format(*self.snr_interval95 or ())}; of one "
            f"frame {self.snr_of_a_frame:.3g}: {self.signal_dn:.4g} DN of signal over "
            f"{self.noise_dn:.3g} DN of noise",
            *(f"{name}: {load:.3g} of {most:.3g}" for name, (load, most) in self.loads.items()),
            *(f"note: {note}" for note in self.notes),
        ]
        return "\n".join(lines)


@documented
def expose(
    sensor: Annotated[
        "str | Path | Camera",
        Argument("The camera: a shipped name, a TOML file, or a description, such as that of fit."),
    ],
    *,
    snr: Annotated[
        float, Setting("Signal-to-noise ratio per pixel to reach.", minimum=1e-3)
    ] = 10.0,
    lux: Annotated[float, Setting("Photopic illuminance on the scene, lux.", minimum=0.0)],
    contrast: Annotated[
        float,
        Setting("Fraction of the signal whose ratio to the noise is meant (1: the signal)."),
    ] = 1.0,
    reflectance: Annotated[float, Setting("Reflectance of the scene, diffuse.")] = 0.5,
    colour_temperature_k: Annotated[
        float, Setting("Colour temperature of the light, K.", minimum=500.0)
    ] = LAMP_K,
    f_number: Annotated[
        float | None, Setting("F-number of the lens (default: of the description).", minimum=0.1)
    ] = None,
    transmission: Annotated[
        float | None, Setting("Transmission of the lens (default: of the description).")
    ] = None,
    longest_ms: Annotated[
        float | None,
        Setting("Longest gate or exposure, ms (default: a whole field).", minimum=1e-6),
    ] = None,
    max_frames: Annotated[int, Setting("Largest number of frames.", minimum=1)] = 1000,
    tube: Annotated[
        str | None,
        Setting("Name of the tube, whose ledger of dose is counted (default: this run alone)."),
    ] = None,
) -> Exposure:
    """Compute gate or exposure, gain and frames that reach a signal-to-noise ratio.

    Returns
    -------
    Exposure
        The settings: the lowest gain that needs at most a tenth more frames than the best, and the
        shortest gate or exposure that needs no more.

    Raises
    ------
    BadInput
        If the ratio cannot be reached within the limits of camera and tube.

    Notes
    -----
    Signal above the dark level over the temporal noise of a pixel, times the root of the frames,
    less what image lag correlates. The illuminance on the detector is E rho pi tau / (4 N^2) / pi
    on the axis, of a distant scene.

    Examples
    --------
    >>> expose("machine-vision", snr=20, lux=1.0, f_number=1.4).frames
    3
    """
    import numpy as np

    from charact.fitting.exposure import ExposureRequest, choose_exposure, exposed_flat
    from labdata.tube_dose import Dose, dose_of, ledger_of, total_dose, warnings

    camera = camera_of(sensor)
    assert camera is not None
    if camera.is_thermal:
        raise BadInput(f"an exposure needs a camera of visible light, got {camera.name!r}")
    if not lux > 0.0:
        raise BadInput(f"`lux` must be positive, got {lux:g}")
    for name, value in (("contrast", contrast), ("reflectance", reflectance)):
        if not 0.0 < value <= 1.0:
            raise BadInput(f"`{name}` must lie in (0, 1], got {value:g}")
    lens = {"optics.f_number": f_number, "optics.transmission": transmission}
    camera = camera.with_values({path: value for path, value in lens.items() if value is not None})
    field_s = 1.0 / float(camera.video.field_rate_hz)
    longest_s = field_s if longest_ms is None else min(1e-3 * longest_ms, field_s)
    if camera.has_tube:
        limit_s = min(1e-9 * float(camera.limits.gate_ns), float(camera.limits.gate_duty) * field_s)
        longest_s = min(longest_s, limit_s)
    detector_lux = lux * reflectance * _lux_per_scene_lux(camera, colour_temperature_k)
    request = ExposureRequest(
        camera=camera,
        lux=detector_lux,
        snr=snr,
        contrast=contrast,
        longest_s=longest_s,
        max_frames=max_frames,
    )
    at, frames = choose_exposure(request)
    flat, gate_s = request.flat(at), at.exposure_s or 1e-9 * (at.gate_ns or 0.0)
    notes = [
        f"Reflectance {reflectance:g}, f/{float(camera.optics.f_number):g}, transmission "
        f"{float(camera.optics.transmission):g}, light of {colour_temperature_k:g} K, on the axis "
        "of a distant scene; noise in time alone, fixed patterns corrected."
    ]
    charge, intervals = None, (None, None)
    if request.draws is None:
        notes.append("No interval: the description has no posterior draws, which `fit` makes.")
    else:
        drawn = exposed_flat(camera, request.draws, detector_lux, at)
        snrs, numbers = drawn.snr(frames, contrast), drawn.frames(snr, contrast).astype(int)
        intervals = tuple(
            tuple(np.quantile(x, (0.025, 0.975), method="nearest").tolist())
            for x in (snrs, numbers)
        )
    if request.limits is not None:
        load, lit_s = request.limits.load, frames * camera.fields * field_s
        dose = dose_of(
            delivered_na_per_cm2=load.screen_na_per_cm2(
                detector_lux, at.mcp_v or 0.0, gate_s / field_s
            ),
            lit_s=lit_s,
            at_gain_s=lit_s,
            point=False,
            log_sd=load.log_sd(at.mcp_v or 0.0),
        )
        charge = dose.screen_c_per_cm2
        before = Dose() if tube is None else ledger_of(tube).total()
        notes += warnings(total_dose((before, dose)), camera)
    return Exposure(
        camera=camera.name,
        frames=frames,
        frames95=intervals[1],
        gate_s=gate_s,
        mcp_v=at.mcp_v,
        em_gain=at.em_gain,
        snr=float(flat.snr(frames, contrast)[0]),
        snr_interval95=intervals[0],
        snr_of_a_frame=float(flat.snr(1, contrast)[0]),
        signal_dn=float(flat.light_dn[0]),
        noise_dn=float(np.sqrt(flat.variance_dn2[0])),
        detector_lux=detector_lux,
        loads=request.loads(at),
        screen_c_per_cm2=charge,
        notes=tuple(notes),
    )


def _lux_per_scene_lux(camera: "Camera", colour_temperature_k: float) -> float:
    """Return 2856 K light on photocathode or chip, lux, for 1 lux on a white diffuse scene, by the
    simulator's lens and its photometry.
    """
    import numpy as np

    from simulate.camera.camera import CameraModel
    from simulate.camera.tube_photometry import photons_per_lux
    from simulate.radiance.spectrum import planck

    bands_nm = np.arange(FIRST_NM, LAST_NM + BAND_NM, BAND_NM, dtype=float)
    photons, of_lamp = (
        photons_per_lux(camera, bands_nm, planck(bands_nm, kelvin))[0]
        for kelvin in (colour_temperature_k, LAMP_K)
    )
    return CameraModel(camera).lens().gathering_sr / np.pi * photons / of_lamp
