"""Simulated sets of a bench, and defects put into them: what a session gives to a validation,
without its files.
"""

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from charact.method import Context
from charact.validation import (
    PARAMETERS,
    MatchedFrames,
    MatchedStacks,
    Numbers,
    ParameterChange,
    ParameterControl,
    change_parameter,
    features_of,
    simulate_frames,
)
from labdata import Camera, Conditions, Kind, Target, load_camera
from labdata.camera.parameters import Draws
from tests.charact.validation.defects import Defect, Digitiser

Frames = Mapping[str, NDArray]

# Light of the three flats, lux or photons a pixel where a wavelength is known, and conditions.
LIGHT: dict[str, tuple[tuple[float, float, float], Conditions]] = {
    "pulnix-ag5745ef3": ((3e-5, 1e-4, 2e-4), Conditions(mcp_v=800.0, gate_ns=1.6e7)),
    "emccd-512": (
        (3e-4, 1e-3, 4e-3),
        Conditions(em_gain=50.0, temperature_c=-20.0, exposure_s=0.025),
    ),
    "machine-vision": (
        (2050.0, 7200.0, 15_800.0),
        Conditions(wavelength_nm=530.0, temperature_c=25.0, exposure_s=0.01),
    ),
}
# Photons a pixel at full scale of the machine-vision camera.
FULL_SCALE = (4095.0 - 30.0) / 0.33 / 0.6
# Parameters of the posterior and their relative standard deviation; those of the tube would cost
# seconds a draw.
POSTERIOR = {
    "video.conversion_gain_dn_per_e": 0.01,
    "optics.aberration_blur_um": 0.02,
    "ccd.read_noise_e": 0.02,
}


class BenchSets:
    """Sets of a dark, three flats, an edge and a point of one camera, each from its own posterior
    draw.

    Parameters
    ----------
    name
        Name of a shipped camera.
    seed
        Seed of draws and frames.
    shape
        Rows and columns of dark and flats.
    lights
        Light of the flats in place of that of `LIGHT`.
    """

    def __init__(
        self,
        name: str,
        *,
        seed: int,
        shape: tuple[int, int] = (192, 256),
        lights: tuple[float, ...] = (),
    ) -> None:
        usual_lights, conditions = LIGHT[name]
        lights, photons = lights or usual_lights, conditions.wavelength_nm is not None
        camera = load_camera(name)
        self.camera = camera
        self.seed = seed
        rng = np.random.default_rng(seed)
        known = self.camera.parameters()
        names = tuple(path for path in POSTERIOR if path in known)
        rows = [
            tuple(float(known[k]) * (1.0 + POSTERIOR[k] * rng.standard_normal()) for k in names)
            for _ in range(64)
        ]
        self.sensor: Camera = replace(self.camera, draws=Draws(names=names, values=tuple(rows)))

        def stack(
            kind: Kind,
            label: str,
            light: float | None,
            size: tuple[int, int],
            target: Target,
            count: int,
        ) -> MatchedFrames:
            return MatchedFrames(
                label=label,
                kind=kind,
                conditions=replace(
                    conditions, **{"photons_per_px" if photons else "illuminance_lux": light}
                ),
                target=target,
                frames=count,
                corner=(0, 0),
                shape=size,
            )

        self.chosen = MatchedStacks(
            dark=stack("dark", "dark", None, shape, Target(), 8),
            flats=tuple(
                stack("flat", label, light, shape, Target(), 8)
                for label, light in zip(("low", "mid", "bright"), lights, strict=True)
            ),
            edge=stack("edge", "edge", lights[-1], (shape[0], 96), Target(angle_deg=5.0), 16),
            point=stack(
                "point",
                "point",
                (1.0 if photons else 300.0) * lights[-1],
                (96, 96) if photons else (128, 128),
                Target(pinhole_px=3.0),
                8,
            ),
            display_only=(),
            measured={},
            notes=(),
        )
        self.top = float(2**self.camera.video.bit_depth - 1)
        self.context = Context(
            seed=0,
            quick=True,
            camera=self.camera if self.camera.has_tube else None,
            interlaced=self.camera.video.interlaced,
            full_scale_dn=self.top,
        )

    def draw(self, number: int) -> tuple[Camera, int]:
        """Return the posterior draw and the seed of the frames of a set."""
        rng = np.random.default_rng([self.seed, number])
        drawn = replace(self.sensor.draw(rng), name=f"{self.camera.name}, set {number}")
        return drawn, int(rng.integers(2**31))

    def frames(self, number: int, defect: Defect | None = None) -> dict[str, NDArray]:
        """Return the frames of a set by label, with a defect or none."""
        drawn, seed = self.draw(number)
        if defect is not None and defect.factors:
            known = drawn.parameters()
            changed = {
                path: float(known[path]) * by
                for path, by in defect.factors.items()
                if path in known
            }
            drawn = drawn.with_values(changed)
        frames = simulate_frames(drawn, self.chosen.compared, seed=seed)
        return frames if defect is None else self.put(frames, defect)

    def change(
        self, number: int, control: ParameterControl, error: float
    ) -> tuple[Mapping[str, Numbers], float] | None:
        """Return the numbers of a set whose camera has a parameter off, and the error; None without
        the parameter.
        """
        drawn, seed = self.draw(number)
        altered = change_parameter(drawn, control, error)
        if altered is None:
            return None
        camera, change = altered
        return self.numbers(simulate_frames(camera, self.chosen.compared, seed=seed)), change

    def change_of(
        self, control: ParameterControl, change: float, number: int = 0
    ) -> ParameterChange:
        """Return the change of a set by that of a parameter that the camera has."""
        altered = self.change(number, control, change)
        assert altered is not None
        changed, change = altered
        return ParameterChange(
            title=control.title,
            plain=self.numbers_of(number),
            changed=changed,
            change=change,
            power=control.power,
            least_error=control.least_error(self.sensor),
        )

    @cache  # noqa: B019  # a bench lives as long as its test
    def numbers_of(self, number: int) -> Mapping[str, Numbers]:
        """Numbers of a set."""
        return self.numbers(self.frames(number))

    @property
    def controls(self) -> tuple[ParameterControl, ...]:
        """Parameters that the camera has."""
        return tuple(one for one in PARAMETERS if one.path_in(self.camera) is not None)

    def changes(self) -> tuple[ParameterChange, ...]:
        """Return the changes of set 0 by those of the parameters that the camera has."""
        return tuple(self.change_of(control, control.change) for control in self.controls)

    def put(self, frames: Frames, defect: Defect) -> dict[str, NDArray]:
        """Return frames with a defect, in whole DN within the digitiser's range."""
        if defect.put is None:
            return dict(frames)
        black, out = float(frames["dark"].mean()), dict(frames)
        for label in defect.stacks:
            before = frames[label]
            adc = Digitiser(black=black, top=self.top, noise=float(before.std(axis=0).mean()))
            # One seed for all stacks: dust lies at one place.
            changed = defect.put(before.astype(float), adc, np.random.default_rng([self.seed, 5]))
            out[label] = np.clip(np.rint(changed), 0.0, self.top).astype(before.dtype)
        return out

    def has(self, defect: Defect) -> bool:
        """Whether the camera can have a defect."""
        if defect.has_tube is not None and defect.has_tube != self.camera.has_tube:
            return False
        return not defect.factors or any(
            path in self.camera.parameters() for path in defect.factors
        )

    def numbers(self, frames: Frames) -> Mapping[str, Numbers]:
        """Return the numbers of a set by group."""
        return features_of(frames, self.chosen, context=self.context).groups
