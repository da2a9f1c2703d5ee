"""Random pictures before random cameras: what the economy of the simulator is tried on, each from a
number of its own.

A scene is a picture in photoelectrons with a camera, its conditions and a tolerance. Pictures are
flats, darks, gradients, smooth fields, edges, bars, and any of these with lamps in them. Cameras
are the case study with its own and with other screens, and the digital one, their uncertain numbers
drawn from their ranges.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np

from labdata import Array, Camera, Conditions, load_phosphor, load_sensor, phosphor_names
from labdata.camera import Parameter
from simulate.camera import CameraModel

REFERENCE_V = 800.0
# Light with saturation, blooming and halo at one end, less than the dark emission at the other;
# photoelectrons.
LEVELS_PE = 1e-3, 1e3
LAMPS_PE = 1.0, 1e5
GAINS = 300.0, 60000.0
TOLERANCES = 0.02, 0.5
TEMPERATURES_C = -20.0, 50.0
SHORTEST_GATE_NS = 1e4
MOST_LAMPS = 4


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A picture that a camera is about to take.

    Parameters
    ----------
    number
        The number it follows from.
    kind
        What the picture shows, in a word.
    camera
        The camera, everything in it.
    image_pe
        Photoelectrons per pixel as read and exposure, shape (row, col).
    conditions
        Voltage, gate and temperature.
    tolerance
        What economy may change, as a share of the temporal noise.
    """

    number: int
    kind: str
    camera: CameraModel
    image_pe: Array
    conditions: Conditions
    tolerance: float


def random_scene(number: int, shape: tuple[int, int] | None = None) -> Scene:
    """Return a scene of a number.

    Parameters
    ----------
    number
        The same number is the same scene.
    shape
        Rows and columns of the frame; the camera's own if None.
    """
    rng = np.random.default_rng([number, 2026])
    sensor = random_sensor(rng)
    if shape is not None:
        sensor = replace(sensor, ccd=replace(sensor.ccd, rows=shape[0], columns=shape[1]))
    camera = CameraModel(
        sensor, geometry=bool(rng.integers(2)), local_depletion=bool(rng.integers(2))
    )
    kind, image = random_picture(rng, camera.shape)
    gain = _between(rng, *GAINS) / float(sensor.tube.luminous_gain)
    field_ns = 1e9 * camera.field_s
    conditions = Conditions(
        mcp_v=REFERENCE_V * gain ** (1.0 / float(sensor.microchannel_plate.gain_exponent)),
        gate_ns=None if rng.random() < 0.5 else _between(rng, SHORTEST_GATE_NS, field_ns),
        temperature_c=None if rng.random() < 0.5 else rng.uniform(*TEMPERATURES_C),
    )
    return Scene(
        number=number,
        kind=kind,
        camera=camera,
        image_pe=image,
        conditions=conditions,
        tolerance=_between(rng, *TOLERANCES),
    )


def random_sensor(rng: np.random.Generator) -> Camera:
    """Return the case study, the case study with another screen, or the digital camera, half of
    them as described.
    """
    sensor = load_sensor(
        str(rng.choice(["pulnix-ag5745ef3", "pulnix-ag5745ef3", "gen3-digital-iccd"]))
    )
    if rng.random() < 0.5:
        sensor = replace(sensor, phosphor=load_phosphor(str(rng.choice(phosphor_names()))))
    return sensor.with_values(_drawn(sensor, rng)) if rng.random() < 0.5 else sensor


def _drawn(sensor: Camera, rng: np.random.Generator) -> dict[str, float]:
    """A value inside its range for every number that effects follow from."""
    values: dict[str, float] = {}
    for section in (
        "photocathode",
        "microchannel_plate",
        "tube",
        "phosphor",
        "taper",
        "ccd",
        "video",
    ):
        part = getattr(sensor, section)
        for item in fields(part):
            value = getattr(part, item.name)
            if isinstance(value, Parameter) and value.low is not None and value.high is not None:
                values[f"{section}.{item.name}"] = rng.uniform(value.low, value.high)
    return values


def random_picture(rng: np.random.Generator, shape: tuple[int, int]) -> tuple[str, Array]:
    """Return a picture and what it shows."""
    kinds: dict[str, Callable[[np.random.Generator, tuple[int, int]], Array]] = {
        "dark": _dark,
        "flat": _flat,
        "gradient": _gradient,
        "smooth field": _smooth,
        "edge": _edge,
        "bars": _bars,
    }
    kind = str(rng.choice(list(kinds)))
    image = kinds[kind](rng, shape)
    lamps = int(rng.integers(1, MOST_LAMPS + 1)) if rng.random() < 0.4 else 0
    for _ in range(lamps):
        row, col = (int(rng.integers(size)) for size in shape)
        side = int(rng.integers(1, 4))
        image[row : row + side, col : col + side] += _between(rng, *LAMPS_PE)
    return (f"{kind} with lamps" if lamps else kind), image


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    """A number whose logarithm is even."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _level(rng: np.random.Generator) -> float:
    return _between(rng, *LEVELS_PE)


def _dark(rng: np.random.Generator, shape: tuple[int, int]) -> Array:
    return np.zeros(shape)


def _flat(rng: np.random.Generator, shape: tuple[int, int]) -> Array:
    return np.full(shape, _level(rng))


def _along(rng: np.random.Generator, shape: tuple[int, int]) -> Array:
    """Distance from a random place in a random direction, pixels."""
    row, col = np.mgrid[: shape[0], : shape[1]]
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return (row - rng.uniform(0, shape[0])) * np.sin(angle) + (
        col - rng.uniform(0, shape[1])
    ) * np.cos(angle)


def _gradient(rng: np.random.Generator, shape: tuple[int, int]) -> Array:
    along = _along(rng, shape)
    return _level(rng) * (1.0 + rng.uniform(0.0, 1.0) * along / np.abs(along).max())


def _smooth(rng: np.random.Generator, shape: tuple[int, int]) -> Array:
    from scipy.ndimage import gaussian_filter

    field = gaussian_filter(rng.standard_normal(shape), _between(rng, 2.0, 40.0), mode="reflect")
    return _level(rng) * np.exp(rng.uniform(0.0, 1.5) * field / field.std())


def _edge(rng: np.random.Generator, shape: tuple[int, int]) -> Array:
    return np.where(_along(rng, shape) > 0.0, _level(rng), _level(rng))


def _bars(rng: np.random.Generator, shape: tuple[int, int]) -> Array:
    period = _between(rng, 2.0, 60.0)
    return np.where(
        np.sin(2.0 * np.pi * _along(rng, shape) / period) > 0.0, _level(rng), _level(rng)
    )
