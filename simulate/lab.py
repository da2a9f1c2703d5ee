"""Lab bench: frames of a target before a camera of visible light, and their noiseless mean."""

from collections import OrderedDict
from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labdata import BadInput, Camera, Conditions, Kind, Target
from labdata.frames import FrameStack, read_only
from simulate.camera import tube_photometry as photometry
from simulate.camera.camera import CameraModel
from simulate.camera.chain import Slot
from simulate.camera.stage_image import StageImage
from simulate.radiance.lab_target import PlacedTarget, TargetView, sum_bench_bands
from simulate.radiance.scene import LabScene, load_bench
from simulate.radiance.spectrum import planck

WAVELENGTH_NM = np.arange(450.0, 951.0, 50.0)


class LabBench:
    """A camera on an optical bench.

    The image of each target is rendered and blurred once and kept; light level, gate and gain then
    cost nothing.

    Parameters
    ----------
    sensor
        Description of the camera, whose values are taken as the truth.
    scene
        The bench: a `LabScene`, the name of a shipped one or a TOML file; the shipped bench if
        None.
    left_out
        Neglected effects of the camera, see `simulate.camera.chain.Stage.effects`.
    like
        Bench of a camera with the same pixels and nearly the same optics: targets lie as before it,
        so that benches of many draws of one camera share their images. None: none.

    Notes
    -----
    The bench states the illuminance *at the photocathode*, or at the chip of a camera without a
    tube, of the target's brightest large area, as a meter in its place would read it; light on a
    chip may be stated as `photons_per_px` of one wavelength instead. What the lens does to the
    light on its way there is therefore left out, its blur and veiling glare excepted: loss,
    fall-off, vignetting, distortion. So is the fibres' geometry, as targets are known on the frame,
    and protection from bright sources, since the bench stays far below a lux. For these, see
    `simulate.camera.scene_to_photoelectrons.mcp_input_from_radiance`.
    """

    def __init__(
        self,
        sensor: Camera,
        scene: LabScene | str | Path | None = None,
        *,
        left_out: frozenset[str] = frozenset(),
        like: "LabBench | None" = None,
    ) -> None:
        self.camera = CameraModel(sensor, left_out=left_out)
        self.scene = scene if isinstance(scene, LabScene) else load_bench(scene or "bench")
        self._like = like
        self._pictures: OrderedDict[tuple[Kind, Target, float | None], NDArray[np.float32]] = (
            OrderedDict()
        )

    def expose(
        self,
        kind: Kind,
        target: Target,
        conditions: Conditions,
        *,
        frames: int,
        seed: int,
        first_frame: int = 0,
    ) -> FrameStack:
        """Return a number of simulated frames of a target, (frame, row, col), in whole DN.

        Parameters
        ----------
        kind
            "dark", "flat", "edge", "bars" or "point".
        target
            The target; what it leaves open is the bench's default.
        conditions
            Illuminance at the photocathode, gate, voltage and temperature in force.
        frames, first_frame
            Number of frames, and the number of the first.
        seed
            Seed: a frame follows from it and from its own number.

        Raises
        ------
        BadInput
            If a condition is missing or out of bounds, or the target lacks what its kind needs.
        """
        if frames < 1:
            raise BadInput(f"a stack must have at least one frame, got {frames}")
        stream = self.stream(kind, target, conditions, seed=seed, first_frame=first_frame)
        numbers = np.arange(first_frame, first_frame + frames)
        return FrameStack(
            data=np.stack(list(islice(stream, frames))),
            time_s=numbers * self.camera.frame_s,
            frame_number=numbers,
            full_scale_dn=float(2**self.camera.description.video.bit_depth - 1),
        )

    def stream(
        self, kind: Kind, target: Target, conditions: Conditions, *, seed: int, first_frame: int = 0
    ) -> Iterator[NDArray[np.unsignedinteger]]:
        """Yield frames; never ends. Arguments as for `expose`."""
        at_mcp = self.mcp_input(kind, target, conditions)
        return self.camera.frames(at_mcp, conditions, seed=seed, first_frame=first_frame)

    def mean(self, kind: Kind, target: Target, conditions: Conditions) -> NDArray[np.float32]:
        """Return the frame without noise, rounding or clipping by the digitiser, shape (row, col),
        DN.
        """
        return self.camera.mean_frame(self.mcp_input(kind, target, conditions), conditions)

    def mcp_input(self, kind: Kind, target: Target, conditions: Conditions) -> StageImage:
        """Return the expected photoelectrons at the MCP input or in the chip, per cell and
        exposure, EBI included.
        """
        camera = self.camera

        def lit(light: np.float32) -> NDArray[np.float32]:
            picture = self._picture(kind, target, conditions) * light
            # Maps of a camera contain the shading of the light of its flats.
            return picture * camera.specimen.of_light(camera.cells) if kind == "flat" else picture

        if not camera.has_tube:
            if kind == "dark":
                return StageImage(
                    values=np.zeros(camera.cells.shape, np.float32), grid=camera.cells
                )
            light = np.float32(
                self._lux(kind, conditions) * camera.stage(Slot.SILICON, conditions).exposure_s
            )
            return StageImage(values=lit(light), grid=camera.cells)
        cathode = camera.stage(Slot.PHOTOCATHODE, conditions)
        dark = cathode.ebi_per_s_cm2 * camera.cells.cell_area_cm2 * cathode.open_s
        if kind == "dark":
            return StageImage(
                values=np.full(camera.cells.shape, dark, np.float32), grid=camera.cells
            )
        light = lit(np.float32(self._lux(kind, conditions) * cathode.open_s))
        return StageImage(values=light + np.float32(dark), grid=camera.cells)

    def without(self, left_out: frozenset[str]) -> "LabBench":
        """Return the bench with neglected camera effects."""
        return LabBench(self.camera.description, self.scene, left_out=left_out)

    def photoelectrons(self, kind: Kind, target: Target, conditions: Conditions) -> StageImage:
        """Return the expected photoelectrons from the cathode, per scene cell and exposure, before
        any blur.
        """
        cells = self.camera.scene_cells
        if kind == "dark":
            return StageImage(values=np.zeros(cells.shape, np.float32), grid=cells)
        lux = np.float32(self._lux(kind, conditions))
        return self.camera.photoelectrons(
            StageImage(values=self._photons(kind, target) * lux, grid=cells), conditions
        )

    def _picture(self, kind: Kind, target: Target, conditions: Conditions) -> NDArray[np.float32]:
        """Photoelectrons at the MCP input, or in the chip, per s and cell at 1 lux, shape of the
        camera's cells.

        The wavelength of narrow light, where conditions state it, is that of diffraction.
        """
        key = (kind, target, conditions.wavelength_nm)
        if key not in self._pictures:
            scene_light = StageImage(
                values=self._photons(kind, target), grid=self.camera.scene_cells
            )
            chain = self.camera.chain(Conditions(wavelength_nm=conditions.wavelength_nm))
            if self.camera.has_tube:
                front = chain.between(Slot.OPTICS, Slot.GAP)
                one_second = replace(front[Slot.PHOTOCATHODE], gate_s=1.0, ebi_per_s_cm2=0.0)
            else:
                front = chain.between(Slot.OPTICS, Slot.SILICON)
                one_second = replace(front[Slot.SILICON], exposure_s=1.0)
            self._pictures[key] = front.replacing(one_second).mean(scene_light).values
        self._pictures.move_to_end(key)
        while len(self._pictures) > 12:
            self._pictures.popitem(last=False)
        return self._pictures[key]

    def _photons(self, kind: Kind, target: Target) -> NDArray[np.float32]:
        """Photons per s and cell at 1 lux, referred to the wavelength of peak quantum efficiency,
        before any blur.
        """
        scene = self._scene_of(target)
        per_cm2, weight = self._photons_per_lux(scene)
        # Rounded, so that devices of one type share their images.
        digits = tuple(float(f"{band:.9e}") for band in weight)
        relative = _relative_picture(scene, kind, target, self._view(target), digits)
        return relative * np.float32(per_cm2 * self.camera.scene_cells.cell_area_cm2)

    def _photons_per_lux(self, scene: LabScene) -> tuple[float, NDArray[np.float64]]:
        """Photons per s and cm2 of the port's light at 1 lux, and what turns radiance in bands into
        photons.
        """
        port = planck(WAVELENGTH_NM, scene.sphere.temperature_k) * scene.open.transmittance_at(
            WAVELENGTH_NM
        )
        return photometry.photons_per_lux(self.camera.description, WAVELENGTH_NM, port)

    def _lux(self, kind: Kind, conditions: Conditions) -> float:
        """Illuminance at photocathode or chip, lux; of light stated in photons, one that frees as
        many electrons.
        """
        camera, photons = self.camera, conditions.photons_per_px
        if conditions.illuminance_lux is not None:
            return conditions.illuminance_lux
        if camera.has_tube or photons is None or conditions.wavelength_nm is None:
            alternative = "" if camera.has_tube else ", or photons_per_px and wavelength_nm,"
            raise BadInput(
                f"illuminance_lux{alternative} must be given for a stack of kind {kind!r}, got none"
            )
        silicon = camera.description.silicon
        efficiency = np.interp(
            conditions.wavelength_nm, silicon.wavelength_nm, silicon.quantum_efficiency, 0.0, 0.0
        )
        per_cm2, _ = self._photons_per_lux(self.scene)
        photoelectrons = photons * float(efficiency) / max(silicon.quantum_efficiency)
        return photoelectrons / (per_cm2 * camera.field_pixel_area_cm2 * camera.open_s(conditions))

    def _scene_of(self, target: Target) -> LabScene:
        """The bench with a plate of the target's contrast; without one the plate is as opaque as
        the scene says.
        """
        if target.contrast is None:
            return self.scene
        clear = self.scene.open
        dark = (1.0 - target.contrast) / (1.0 + target.contrast)
        mask = replace(
            clear,
            transmittance=tuple(dark * transmittance for transmittance in clear.transmittance),
            reflectance=tuple(0.0 for _ in clear.reflectance),
        )
        return replace(self.scene, mask=mask)

    def _view(self, target: Target) -> TargetView:
        """The scene's cells on the target's plane, in column pitches about the target's centre."""
        if self._like is not None:
            return self._like._view(target)
        camera, cells = self.camera, self.camera.scene_cells
        ratio = cells.pitch_y_mm / cells.pitch_x_mm
        rows, columns = camera.shape
        row, col, height, width = target.region or (0, 0, rows, columns)
        # Frame rows that sum two rows of the chip are centred half a row further down.
        centre_row = row + height / 2.0 + (0.5 if camera.description.interlaced else 0.0)
        centre_col = col + width / 2.0
        if isinstance(target, PlacedTarget):
            centre_row, centre_col = np.add((centre_row, centre_col), target.offset_px)
        lens_mm = float(camera.description.optics.focal_length_mm)
        return TargetView(
            shape=cells.shape,
            cell_px=(1.0 / cells.per_column, ratio / cells.per_row),
            corner_px=(
                -cells.margin_columns - centre_col,
                (-cells.margin_rows - centre_row) * ratio,
            ),
            metre_per_px=cells.pitch_x_mm * self.scene.distance_m / lens_mm,
            distance_m=self.scene.distance_m,
            eye_px=(columns / 2.0 - centre_col, (cells.rows / 2.0 - centre_row) * ratio),
        )


@lru_cache(maxsize=6)
def _relative_picture(
    scene: LabScene, kind: Kind, target: Target, view: TargetView, weight: tuple[float, ...]
) -> NDArray[np.float32]:
    """A target's light on cells of the view, relative to that of a large open area, shape (row,
    col).
    """
    picture = np.empty(view.shape, np.float32)
    for slices, tile in view.tiles(128):
        picture[slices] = sum_bench_bands(
            scene, kind, target, tile, WAVELENGTH_NM, np.array(weight)
        )
    return read_only(picture)
