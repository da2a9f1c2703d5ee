"""Exposure that reaches a signal-to-noise ratio with a described camera."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from labdata.errors import BadInput
from labdata.settings import Argument, Setting, documented

if TYPE_CHECKING:
    from labdata import Camera, Conditions

LAMP_K = 2856.0  # colour temperature at which tubes are specified
# Bands of the light, nm: all that photocathodes, silicon and the eye detect.
FIRST_NM, LAST_NM, BAND_NM = 360, 1100, 10


@dataclass(frozen=True, kw_only=True)
class Exposure:
    """Settings that reach a signal-to-noise ratio, and what they give."""

    camera: str  #: Name of the camera
    #: Gate and MCP voltage, or exposure and EM gain, under 2856 K light on the detector that gives
    #: the same signal as the scene
    conditions: "Conditions"
    frames: int  #: Number of frames whose mean has the ratio
    frames95: tuple[float, float] | None  #: 95 % interval of the number that is needed
    snr: float  #: Ratio of the mean of all frames, per pixel
    snr_interval95: tuple[float, float] | None  #: Its 95 % interval by the posterior, if any
    signal_dn: float  #: Signal of the light, DN
    noise_dn: float  #: Temporal noise of a pixel of one frame, DN
    #: What the settings load, by name with its unit, and the most that it takes
    loads: dict[str, tuple[float, float]]
    notes: tuple[str, ...]  #: What was assumed, and warnings

    def __str__(self) -> str:
        at, interval = self.conditions, " ({:.3g} to {:.3g}, 95 %)"
        gate = f"gate {1e-6 * (at.gate_ns or 0.0):.4g} ms, MCP {at.mcp_v or 0.0:.0f} V"
        gain = "" if at.em_gain is None else f", EM gain {at.em_gain:.3g}"
        exposure = f"exposure {1e3 * (at.exposure_s or 0.0):.4g} ms{gain}"
        lines = [
            f"{self.camera}: {gate if at.gate_ns else exposure}",
            f"frames {self.frames}" + (interval.format(*self.frames95) if self.frames95 else ""),
            f"SNR of a pixel {self.snr:.3g}"
            + (interval.format(*self.snr_interval95) if self.snr_interval95 else "")
            + f"; of a frame {self.signal_dn:.4g} DN of light over {self.noise_dn:.3g} DN of noise",
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
    from labdata.sensors import load_camera
    from labdata.tube_dose import Dose, dose_of, ledger_of, total_dose, warnings

    camera = load_camera(sensor) if isinstance(sensor, str | Path) else sensor
    if camera.is_thermal or float(camera.video.gamma) != 1.0:
        raise BadInput(
            f"an exposure needs a camera of visible light and gamma 1, got {camera.name!r}"
        )
    most = {"lux": (lux, 1e6), "contrast": (contrast, 1.0), "reflectance": (reflectance, 1.0)}
    for name, (value, limit) in most.items():
        if not 0.0 < value <= limit:
            raise BadInput(f"`{name}` must lie in (0, {limit:g}], got {value:g}")
    lens = {"optics.f_number": f_number, "optics.transmission": transmission}
    camera = camera.with_values({path: value for path, value in lens.items() if value is not None})
    field_s = 1.0 / float(camera.video.field_rate_hz)
    times_s = [field_s, *([] if longest_ms is None else [1e-3 * longest_ms])]
    if camera.has_tube:
        duty, gate_ns = float(camera.limits.gate_duty), float(camera.limits.gate_ns)
        times_s += [duty * field_s, 1e-9 * gate_ns]
    request = ExposureRequest(
        camera=camera,
        lux=lux * reflectance * _lux_per_scene_lux(camera, colour_temperature_k),
        snr=snr,
        contrast=contrast,
        longest_s=min(times_s),
        max_frames=max_frames,
    )
    at, frames = choose_exposure(request)
    flat, drawn, loads = (
        request.flat(at),
        exposed_flat(camera, request.draws, at),
        request.loads(at),
    )
    snrs, numbers = drawn.snr(frames, contrast), drawn.frames(snr, contrast)
    intervals = [np.quantile(drawn_of, (0.025, 0.975)) for drawn_of in (snrs, numbers)]
    (snr_low, snr_high), (frames_low, frames_high) = np.array(intervals).tolist()
    notes = [
        f"Reflectance {reflectance:g}, f/{float(camera.optics.f_number):g}, transmission "
        f"{float(camera.optics.transmission):g}, light of {colour_temperature_k:g} K, on the axis "
        "of a distant scene; noise in time alone, fixed patterns corrected."
    ]
    if not camera.draws.values:
        notes.append("No interval: the description has no posterior draws, which `fit` makes.")
    if request.limits is not None:
        load, lit_s, mcp_v = request.limits.load, frames * camera.fields * field_s, at.mcp_v or 0.0
        duty = 1e-9 * (at.gate_ns or 0.0) / field_s
        dose = dose_of(
            delivered_na_per_cm2=load.screen_na_per_cm2(request.lux, mcp_v, duty),
            lit_s=lit_s,
            at_gain_s=lit_s,
            point=False,
            log_sd=load.log_sd(mcp_v),
        )
        life = float(camera.limits.screen_charge_c_per_cm2)
        loads["screen, C/cm2"] = dose.screen_c_per_cm2, life
        before = Dose() if tube is None else ledger_of(tube).total()
        notes += warnings(total_dose((before, dose)), camera)
    fitted = bool(camera.draws.values)
    return Exposure(
        camera=camera.name,
        conditions=at,
        frames=frames,
        frames95=(frames_low, frames_high) if fitted else None,
        snr=float(flat.snr(frames, contrast)[0]),
        snr_interval95=(snr_low, snr_high) if fitted else None,
        signal_dn=float(flat.light_dn[0]),
        noise_dn=float(np.sqrt(flat.variance_dn2[0])),
        loads=loads,
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
