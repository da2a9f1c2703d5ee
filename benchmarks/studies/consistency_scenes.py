"""Do edge, bars, points and the noise of flats of one camera agree as often as promised, and is a
fault found out?

Sessions of closed form: one blur before the gain, one behind it and the square pixel, drawn anew
for each session. `benchmarks.studies.consistency_table` measures a hundred of them and prints what
came of it.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from charact.estimators import mtf
from charact.method import Context
from charact.session_measurement import with_stack_label
from labdata import Camera, Conditions, FrameStack, Result, Session, Target, load_sensor
from labdata.session import Kind
from tests.truth.bars import StripScene
from tests.truth.blur import TrueBlur, level_crossing
from tests.truth.edge import EdgeScene
from tests.truth.point import PointScene
from tests.truth.scintillating_flats import ScintillatingFlats
from tests.truth.sessions import session_in_memory, stack_in_memory

Array = NDArray[np.float64]

BARS_CY_PER_PX = (0.08, 0.15, 0.25)
KINDS: dict[str, Kind] = {
    "edge": "edge",
    **{f"bars-{f:g}": "bars" for f in BARS_CY_PER_PX},
    "point": "point",
}


@dataclass(frozen=True)
class TrueCameraChain:
    """Blur before the gain and Gaussian blur behind it, and the square pixel: usable wherever a
    `TrueBlur` is.
    """

    before: TrueBlur
    pulse_px: float

    def transfer(self, fx: Array | float, fy: Array | float) -> Any:
        """MTF at frequencies along rows and columns, cycles per pixel, pixel included."""
        return self.before.transfer(fx, fy) * np.exp(
            -2 * (np.pi * np.hypot(fx, fy) * self.pulse_px) ** 2
        )

    def mtf(self, frequency_cy_per_px: Array | float, angle_deg: float) -> Any:
        """MTF along a direction, pixel included."""
        f, angle = np.asarray(frequency_cy_per_px, float), np.deg2rad(angle_deg)
        return self.transfer(f * np.cos(angle), f * np.sin(angle))

    def with_defocus(self, share: float) -> "TrueCameraChain":
        """The same chain, all its blur before the pixel wider by a share."""
        if self.before.form == "gaussian":
            before = replace(self.before, sigma_px=self.before.sigma_px * (1 + share))
        else:
            before = replace(
                self.before, frequency_cy_per_px=self.before.frequency_cy_per_px / (1 + share)
            )
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
        """A camera and its targets at random: Gaussian blur or the form of tubes before the
        gain.
        """
        if rng.random() < 0.5:
            before = TrueBlur(sigma_px=rng.uniform(0.5, 1.1))
        else:
            before = TrueBlur(
                form="exponential",
                frequency_cy_per_px=rng.uniform(0.2, 0.45),
                exponent=rng.uniform(1.1, 1.7),
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

    def measured(
        self, rng: np.random.Generator, context: Context, *, defocus: float = 0.0, of: str = "edge"
    ) -> Result:
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
            chain = (
                self.chain.with_defocus(defocus) if defocus and label.startswith(of) else self.chain
            )
            result += with_stack_label(self._target(label, chain, rng, context), label)
        flats = ScintillatingFlats(
            half_frequency_cy_per_px=float(
                np.sqrt(np.log(2.0) / 2.0) / (np.pi * self.chain.pulse_px)
            ),
            exponent=2.0,
        )
        return result + mtf.measure_flats(flats.session_drawn(rng), context=context)

    def _target(
        self, label: str, chain: TrueCameraChain, rng: np.random.Generator, context: Context
    ) -> Result:
        blur: Any = chain
        if label == "edge":
            edge = EdgeScene(
                blur=blur,
                angle_deg=self.edge_deg,
                offset_px=self.offset_px[0],
                snr=self.edge_snr,
                noise_blur_px=chain.pulse_px,
                dark_dn=200.0,
                bright_dn=1800.0,
                full_scale_dn=4095.0,
            )
            return mtf.measure("edge", edge.frames_drawn(rng), context=context)
        if label == "point":
            point = PointScene(
                blur=chain.before,
                pulse_px=chain.pulse_px,
                photoelectrons=self.photoelectrons,
                row_px=self.offset_px[0],
                col_px=self.offset_px[1],
                peak_dn=2500.0,
                full_scale_dn=4095.0,
            )
            return mtf.measure("point", point.frames_drawn(rng), context=context)
        frequency = float(label.removeprefix("bars-"))
        strip = StripScene(
            blur=blur,
            frequency_cy_per_px=frequency,
            angle_deg=self.bars_deg,
            phase_px=self.offset_px[1],
            snr=self.bars_snr,
            noise_blur_px=chain.pulse_px,
        )
        asked = {"bars": strip.bars, "frequency_cy_per_px": frequency}
        return mtf.measure("bars", strip.frames_drawn(rng), context=context, **asked)

    def context(self, seed: int, *, quick: bool) -> Context:
        """What methods are told: nothing of the camera."""
        return Context(seed=seed, quick=quick)

    def truth_at(self, level: float, angle_deg: float) -> float:
        """Frequency along a direction at which the MTF falls to a level, cycles per pixel."""
        return level_crossing(lambda f: self.chain.mtf(f, angle_deg), level)


SENSOR = "pulnix-ag5745ef3"
ROWS, COLUMNS, FRAMES = 256, 320, 12
TARGET_LUX, POINT_LUX, FLAT_LUX = 2.5e-4, 1.5e-3, (8e-5, 2.4e-4)
MCP_V, GATE_NS = 800.0, 1.6e7


@dataclass(frozen=True, kw_only=True)
class SimulatedScene:
    """A specimen of an intensified camera before an edge, three groups of bars, a pinhole, even
    light and darkness.

    Parameters
    ----------
    camera
        The specimen.
    edge_deg, bars_deg
        Tilts, degrees.
    """

    camera: Camera
    edge_deg: float
    bars_deg: float

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> "SimulatedScene":
        """A specimen within the ranges of its description."""
        from simulate.virtual_bench.true_sensor import draw_true_sensor

        camera = draw_true_sensor(_small(load_sensor(SENSOR)), int(rng.integers(1 << 31)))
        return cls(camera=camera, edge_deg=rng.uniform(3.0, 12.0), bars_deg=rng.uniform(1.0, 6.0))

    def measured(
        self, rng: np.random.Generator, context: Context, *, defocus: float = 0.0, of: str = "edge"
    ) -> Result:
        """Simulate and measure every target; as for
        `benchmarks.studies.consistency_scenes.SessionScene`.
        """
        result = Result()
        for label, kind in KINDS.items():
            camera = (
                _with_defocus(self.camera, defocus)
                if defocus and label.startswith(of)
                else self.camera
            )
            frames = self._frames(camera, kind, label, rng)
            asked = {
                "bars": {"bars": 4, "frequency_cy_per_px": _frequency(label)},
                "point": {"pinhole_px": 1.0},
            }
            result += with_stack_label(
                mtf.measure(kind, frames, context=context, **asked.get(kind, {})), label
            )
        return result + mtf.measure_flats(self._flats(rng), context=context)

    def context(self, seed: int, *, quick: bool) -> Context:
        """What methods are told: the description of the type, not the specimen."""
        sensor = _small(load_sensor(SENSOR))
        interlaced, full_scale_dn = sensor.video.interlaced, 2.0**sensor.video.bit_depth - 1.0
        return Context(
            seed=seed,
            quick=quick,
            camera=sensor,
            interlaced=interlaced,
            full_scale_dn=full_scale_dn,
        )

    def truth_at(self, level: float, angle_deg: float) -> float:
        """Frequency along a direction at which the MTF falls to a level, cycles per column
        pitch.
        """
        from simulate.camera import true_quantities

        return true_quantities.true_crossing_frequency(self.camera, level, angle_deg)

    def _frames(
        self, camera: Camera, kind: Kind, label: str, rng: np.random.Generator
    ) -> FrameStack:
        target = {
            "edge": Target(angle_deg=self.edge_deg),
            "bars": Target(bars=4, frequency_cy_per_px=_frequency(label), angle_deg=self.bars_deg),
            "point": Target(pinhole_px=1.0),
        }
        return _expose_stack(
            camera, kind, target[kind], POINT_LUX if kind == "point" else TARGET_LUX, rng
        )

    def _flats(self, rng: np.random.Generator) -> Session:
        levels: tuple[tuple[Kind, float], ...] = (
            ("dark", 0.0),
            *(("flat", lux) for lux in FLAT_LUX),
        )
        stacks = tuple(
            stack_in_memory(
                kind,
                _expose_stack(self.camera, kind, Target(), lux, rng),
                _conditions(lux),
                label=f"{kind}-{number}",
            )
            for number, (kind, lux) in enumerate(levels)
        )
        return session_in_memory(stacks, camera=self.camera, bit_depth=8)


def _expose_stack(
    camera: Camera, kind: Kind, target: Target, lux: float, rng: np.random.Generator
) -> FrameStack:
    from simulate.lab import LabBench

    seed = int(rng.integers(1 << 31))
    return LabBench(camera).expose(kind, target, _conditions(lux), frames=FRAMES, seed=seed)


def _conditions(lux: float) -> Conditions:
    return Conditions(illuminance_lux=lux, mcp_v=MCP_V, gate_ns=GATE_NS)


def _small(sensor: Camera) -> Camera:
    return replace(sensor, ccd=replace(sensor.ccd, rows=ROWS, columns=COLUMNS))


def _frequency(label: str) -> float:
    return float(label.removeprefix("bars-")) if label.startswith("bars") else BARS_CY_PER_PX[0]


def _with_defocus(sensor: Camera, share: float) -> Camera:
    """A lens out of focus: its blur grows by this share of a pixel of the chip, as seen through the
    taper.
    """
    pixel_um = float(sensor.ccd.pitch_x_um) * float(sensor.taper.demagnification)
    blur = float(np.hypot(float(sensor.optics.aberration_blur_um), share * pixel_um))
    return sensor.with_values({"optics.aberration_blur_um": blur})
