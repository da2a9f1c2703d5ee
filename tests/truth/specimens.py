"""Sessions of specimens drawn from the ranges of a camera description: darks, flats and an edge of
a small chip.
"""

from dataclasses import replace

import numpy as np

from charact.fitting import prior_of, tube_observations
from charact.frames.image_lag import DECAY
from labdata import Camera, Conditions, Kind, LoadedStackEntry, Session, Target, load_camera
from simulate import LabBench
from tests.truth.sessions import session_in_memory, stack_in_memory

CAMERAS = ("pulnix-ag5745ef3", "gen3-digital-iccd", "emccd-512", "machine-vision")
SHAPE_PX = (200, 260)
FRAMES = 16
# Fractions of the largest linear signal.
LEVELS = (0.02, 0.1, 0.3, 0.6, 1.0)
DRAWN_OF_TUBE = (
    *tube_observations.SHAPE,
    *tube_observations.LEVEL,
    *DECAY,
    "ccd.read_noise_e",
    "ccd.prnu",
    "phosphor.gain_nonuniformity",
)
DRAWN_OF_CHIP = (
    "optics.aberration_blur_um",
    "optics.f_number",
    "ccd.pitch_x_um",
    "ccd.quantum_efficiency",
    "ccd.full_well_e",
    "ccd.read_noise_e",
    "ccd.dark_current_e_per_s",
    "ccd.prnu",
    "ccd.dsnu_e",
    "video.black_level_dn",
    "video.conversion_gain_dn_per_e",
)
TIED = "ccd.pitch_y_um"
FLAT = Target()


def draw_specimen(
    name: str, seed: int, *, uniform: bool = False
) -> tuple[Camera, dict[str, float]]:
    """Return a small specimen of a shipped description, and its drawn parameters by path: from the
    prior, or `uniform` between the ends of their ranges.
    """
    sheet = load_camera(name)
    prior = prior_of(
        sheet, tuple(dict.fromkeys(DRAWN_OF_TUBE if sheet.has_tube else DRAWN_OF_CHIP))
    )
    rng, known = np.random.default_rng([seed, 61 if uniform else 51]), sheet.parameters()
    low, high = np.array([(known[path].low, known[path].high) for path in prior.names]).T
    while True:
        drawn = (
            low + (high - low) * rng.random(low.size)
            if uniform
            else prior.parameters(prior.draw(rng, 1))[0]
        )
        truth = dict(zip(prior.names, drawn.tolist(), strict=True))
        if sheet.has_tube or _is_usable(sheet, truth):
            break
    if "ccd.pitch_x_um" in truth:
        truth[TIED] = truth["ccd.pitch_x_um"]
    specimen = sheet.with_values(truth)
    rows, columns = SHAPE_PX
    return replace(
        specimen, name=f"{name} {seed}", ccd=replace(specimen.ccd, rows=rows, columns=columns)
    ), truth


def _is_usable(sheet: Camera, truth: dict[str, float]) -> bool:
    """Whether the wells suit the digitiser, and the noise its step, as in a camera that somebody
    would sell.
    """
    gain, full = truth["video.conversion_gain_dn_per_e"], 2**sheet.video.bit_depth - 1
    fitting = (
        name_of_class(sheet) == "register" or 0.3 < gain * truth["ccd.full_well_e"] / full < 3.0
    )
    # Noise of reading and of the dark charge of the shortest exposure, twice.
    noise_dn = gain * np.hypot(
        truth["ccd.read_noise_e"], np.sqrt(0.04 * truth["ccd.dark_current_e_per_s"])
    )
    black = truth["video.black_level_dn"]
    if name_of_class(sheet) == "register":
        return fitting
    least_dn = max(8.0 * noise_dn, 4.0 * gain * truth["ccd.dsnu_e"])
    return fitting and gain * truth["ccd.read_noise_e"] > 0.6 and least_dn < black < 0.1 * full


def _signal_per_lux(bench: LabBench, conditions: Conditions, black: float) -> float:
    """Return the signal per lux at a level that is neither lost in rounding nor clipped by the
    wells, DN.
    """
    lux, signal = 1e-7, 0.0
    while signal < 5.0:
        lux *= 4.0
        signal = (
            bench.mean("flat", Target(), replace(conditions, illuminance_lux=lux)).mean(dtype=float)
            - black
        )
    return signal / lux


def _longest_s(truth: dict[str, float]) -> float:
    """Return an exposure whose dark charge fits into a fifth of the well, with a noise far above
    zero DN.
    """
    most_e = (truth["video.black_level_dn"] / (6.0 * truth["video.conversion_gain_dn_per_e"])) ** 2
    charge_e = min(0.2 * truth["ccd.full_well_e"], most_e - truth["ccd.read_noise_e"] ** 2)
    return float(np.clip(charge_e / truth["ccd.dark_current_e_per_s"], 0.04, 0.99))


def name_of_class(camera: Camera) -> str:
    """Return "tube", "register" or "chip": what multiplies electrons."""
    if camera.has_tube:
        return "tube"
    return "register" if camera.register.multiplies else "chip"


def session_of(name: str, seed: int, *, uniform: bool = False) -> tuple[Session, dict[str, float]]:
    """Return the session of a specimen, which names the shipped description, and the specimen's
    parameters.
    """
    specimen, truth = draw_specimen(name, seed, uniform=uniform)
    sheet = load_camera(name)
    bench, kind = LabBench(specimen), name_of_class(specimen)
    frame_s = 1.0 / float(specimen.video.field_rate_hz)
    exposure_s = {"tube": frame_s, "register": 0.2 * frame_s, "chip": 0.02}[kind]
    shared = {
        "tube": {"mcp_v": 800.0, "gate_ns": min(0.95 * frame_s, 0.02) * 1e9},
        "register": {"em_gain": 300.0, "temperature_c": -20.0},
        "chip": {},
    }[kind]
    conditions = Conditions(exposure_s=exposure_s, illuminance_relative_sd=0.0, **shared)
    black, full = float(specimen.video.black_level_dn), 2**specimen.video.bit_depth - 1
    # Below the wells, too: a tube's noise would reach them.
    gain = float(specimen.video.conversion_gain_dn_per_e) * (conditions.em_gain or 1.0)
    largest = 0.6 * min(full - black, float(specimen.ccd.full_well_e) * gain)
    per_lux = _signal_per_lux(bench, conditions, black)
    lux = [part * largest / per_lux for part in LEVELS]
    stacks: list[LoadedStackEntry] = []

    def add(
        label: str, shows: Kind, known: Conditions, target: Target = FLAT, frames: int = FRAMES
    ) -> None:
        exposed = bench.expose(shows, target, known, frames=frames, seed=1000 * seed + len(stacks))
        stacks.append(
            stack_in_memory(
                shows,
                exposed,
                known,
                label=label,
                target=target,
                bit_depth=specimen.video.bit_depth,
            )
        )

    add("dark", "dark", conditions)
    if kind != "tube":
        longer_s = 0.99 * frame_s if kind == "register" else _longest_s(truth)
        add("dark, long", "dark", replace(conditions, exposure_s=longer_s))
    for index, level in enumerate(lux):
        add(f"flat {index}", "flat", replace(conditions, illuminance_lux=level))
    add(
        "edge", "edge", replace(conditions, illuminance_lux=lux[3]), Target(angle_deg=5.0), frames=8
    )
    session = session_in_memory(stacks, camera=sheet, bit_depth=specimen.video.bit_depth)
    return session, truth
