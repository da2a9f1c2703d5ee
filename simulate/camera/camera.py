"""Camera of visible light: stages of its description as one chain, its mean frame, its frames."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import count
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labdata import BadInput, Camera, Conditions
from simulate.camera import tube_photometry
from simulate.camera.automatic_controls import UNTOUCHED, AutomaticControls, AutomaticState
from simulate.camera.ccd import Ccd
from simulate.camera.chain import Chain, Slot, Stage, stages_with_section, values_of
from simulate.camera.fast_sampler.frame_generator import FrameGenerator
from simulate.camera.grid import ACCURACY, CameraFrame
from simulate.camera.lens import Optics, RadiometricLens
from simulate.camera.microchannel import MicrochannelPlate
from simulate.camera.phosphor import Phosphor, PhosphorDecay, apply_phosphor_decay
from simulate.camera.photocathode import Photocathode, ProximityGap
from simulate.camera.pixels import Collection, FieldReadout
from simulate.camera.register import Register
from simulate.camera.silicon import Silicon
from simulate.camera.specimen import SpecimenPatterns, patterns_of
from simulate.camera.stage_image import StageImage
from simulate.camera.taper import FibreGeometry, Taper
from simulate.camera.video import Video

Frames = Iterator[NDArray[np.unsignedinteger]]

# Stages in the order of the light. A camera has those whose section its description has.
STAGES: tuple[type[Stage], ...] = (
    Optics,
    Photocathode,
    ProximityGap,
    FibreGeometry,
    MicrochannelPlate,
    Phosphor,
    Taper,
    Silicon,
    Collection,
    PhosphorDecay,
    FieldReadout,
    Ccd,
    Register,
    Video,
)


@dataclass(frozen=True)
class CameraModel(CameraFrame):
    """Camera of visible light built from its description, with a tube or without.

    Its light "at the MCP" is, without a tube, photoelectrons in the chip. Automatic gain and
    brightness control are off, as they are for any measurement, unless the conditions say that
    they were on.
    """

    description: Camera  # its values are taken as the truth
    # Whether the taper distorts and shears the image. The lab bench measures without: its targets
    # are known on the frame.
    geometry: bool = False
    # Whether an MCP's gain falls place by place under its own load; otherwise all of the MCP falls
    # alike.
    local_depletion: bool = False
    left_out: frozenset[str] = frozenset()  # names of neglected effects, see `Stage.effects`

    @cached_property
    def specimen(self) -> SpecimenPatterns:
        """Fixed patterns of this very camera, where its maps are known."""
        return patterns_of(self)

    def stage(self, slot: Slot, conditions: Conditions | None = None) -> Any:
        """Return the stage in a slot, under conditions, without the effects that are left out."""
        (kind,) = (kind for kind in STAGES if kind.slot == slot)
        return self._built(kind, Conditions() if conditions is None else conditions)

    def _built(self, kind: type[Stage], conditions: Conditions) -> Stage:
        depletion = () if self.local_depletion else ("local gain depletion",)
        return kind.of(self, conditions).without(self.left_out.union(depletion))

    def chain(self, conditions: Conditions, state: AutomaticState = UNTOUCHED) -> Chain:
        """Return the whole chain under conditions, in a state of the automatic controls; without a
        tube there are none, and one that was on is BadInput.

        Its light is in photons per s and cell of `scene_cells`, referred to the wavelength that is
        detected best.
        """
        if not self.has_tube and (conditions.automatic_gain or conditions.brightness_control):
            raise BadInput(
                f"automatic controls must be off, as {self.description.name!r} has none; got one on"
            )
        kinds = stages_with_section(STAGES, self.description)
        chain = Chain(tuple(self._built(kind, conditions) for kind in kinds))
        if not self.has_tube:
            return chain
        if not self.geometry or "taper distortion and fibre shear" in self.left_out:
            chain = chain.without(Slot.FIBRES)
        plate, video = chain[Slot.MCP], chain[Slot.VIDEO]
        return chain.replacing(
            replace(plate, gain=plate.gain * state.brightness),
            replace(video, gain=video.gain * state.gain),
        )

    def lens(self, magnification: float = 0.0) -> RadiometricLens:
        """Return the lens for scenes of known radiance; that of the chain is for light stated at
        the cathode.
        """
        if self.has_tube:
            cathode = self.description.photocathode
            table_nm, efficiency = cathode.wavelength_nm, cathode.relative_quantum_efficiency
        else:
            silicon = self.description.silicon
            table_nm, efficiency = silicon.wavelength_nm, silicon.quantum_efficiency
        return values_of(
            RadiometricLens,
            self.description.optics,
            detector_nm=table_nm,
            detector_efficiency=efficiency,
            grid=self.scene_cells,
            magnification=magnification,
            row_pairs=self.description.interlaced,
        )

    def open_s(self, conditions: Conditions) -> float:
        """Time that gate or shutter is open in one exposure, s: all of it unless the conditions say
        less.
        """
        gate_s = None if conditions.gate_ns is None else conditions.gate_ns * 1e-9
        if not self.has_tube:
            open_times_s = [
                seconds for seconds in (conditions.exposure_s, gate_s) if seconds is not None
            ]
            shortest = min(open_times_s, default=self.frame_s)
            if not 0.0 < shortest <= self.frame_s * 1.001:
                raise BadInput(
                    f"an exposure must be positive and at most one frame, {self.frame_s:.6g} s, "
                    f"got {shortest:g} s"
                )
            return min(shortest, self.frame_s)
        if conditions.gate_ns is None or gate_s is None:
            return self.field_s
        if not 0.0 < conditions.gate_ns <= self.field_s * 1e9 * 1.001:
            raise BadInput(
                f"gate_ns must be positive and at most one exposure, {self.field_s * 1e9:.6g} ns, "
                f"got {conditions.gate_ns:g}"
            )
        return min(gate_s, self.field_s)

    def photoelectrons(self, photons_per_s: StageImage, conditions: Conditions) -> StageImage:
        """Return the expected photoelectrons that light frees, per cell of `scene_cells` and
        exposure.
        """
        if not self.has_tube:
            return self.stage(Slot.SILICON, conditions).detect(photons_per_s)
        cathode = self.stage(Slot.PHOTOCATHODE, conditions)
        return cathode.without(frozenset({"EBI"})).mean(photons_per_s)

    def to_mcp_input(self, photoelectrons: StageImage, conditions: Conditions) -> StageImage:
        """Return the expected photoelectrons at the MCP input, per cell of `cells` and exposure.

        Parameters
        ----------
        photoelectrons
            Per cell and exposure, on `scene_cells`; dark ones of a photocathode are added.
        conditions
            Gate and temperature.
        """
        if not self.has_tube:
            return photoelectrons.resample_to(self.cells)
        cathode = self.stage(Slot.PHOTOCATHODE, conditions)
        dark = np.float32(cathode.ebi_per_s_cm2 * cathode.open_s * self.scene_cells.cell_area_cm2)
        photoelectrons_with_dark = photoelectrons.with_values(photoelectrons.values + dark)
        return self.to_plate(conditions, self.cathode_lux(photoelectrons)).mean(
            photoelectrons_with_dark
        )

    def mcp_input(self, photons_per_s: StageImage, conditions: Conditions) -> StageImage:
        """Return the expected photoelectrons at the MCP input for photons per s and cell of
        `scene_cells`.
        """
        return self.to_mcp_input(self.photoelectrons(photons_per_s, conditions), conditions)

    def cathode_lux(self, photoelectrons: StageImage) -> float:
        """Mean illuminance of 2856 K light over cathode and time, from photoelectrons per cell and
        exposure, lux.
        """
        per_s_cm2 = (
            photoelectrons.values.mean(dtype=float) / self.scene_cells.cell_area_cm2 / self.field_s
        )
        return per_s_cm2 / (tube_photometry.photoelectrons_per_lumen_s(self.description) * 1e-4)

    def photoelectrons_per_pixel(self, photoelectrons: StageImage) -> NDArray[np.floating]:
        """Sum photoelectrons per cell of `scene_cells` to photoelectrons per pixel as read.

        Returns
        -------
        NDArray
            The frame and the margin of `Accuracy.scene_margin_px` or more around it, shape (row,
            col).
        """
        cells = self.scene_cells
        rows, cols = cells.shape[0] // cells.per_row, cells.shape[1] // cells.per_column
        chip = photoelectrons.values.reshape(rows, cells.per_row, cols, cells.per_column).sum(
            axis=(1, 3), dtype=float
        )
        # Field integration sums rows; the last row of the margin has none below it.
        return (
            chip + np.append(chip[1:], chip[-1:], axis=0) if self.description.interlaced else chip
        )

    def to_plate(self, conditions: Conditions, cathode_lux: float) -> Chain:
        """Return the chain from the gap to the MCP input under a mean illuminance of the cathode,
        lux.
        """
        chain = self.chain(conditions).between(Slot.GAP, Slot.MCP).without(Slot.MCP)
        return chain.replacing(replace(chain[Slot.GAP], cathode_lux=cathode_lux))

    def mean_frame(
        self, at_mcp: StageImage, conditions: Conditions, state: AutomaticState = UNTOUCHED
    ) -> NDArray[np.float32]:
        """Return the noiseless frame of a static scene, shape (row, col), DN, neither rounded nor
        clipped.

        Parameters
        ----------
        at_mcp
            Expected photoelectrons at the MCP input per cell and exposure, on `cells`.
        conditions
            Gate, voltage and temperature.
        state
            Where the automatic controls stand.
        """
        chain = self.chain(conditions, state)
        pixels = chain.between(Slot.MCP if self.has_tube else Slot.PIXELS, Slot.PIXELS).mean(at_mcp)
        fields = pixels.with_values(np.repeat(pixels.values[None], self.fields_per_frame, axis=0))
        return (
            chain.between(Slot.SCAN if self.has_tube else Slot.CCD, Slot.VIDEO)
            .mean(fields)
            .values[0]
        )

    def automatic_state_of(
        self, at_mcp: StageImage, conditions: Conditions
    ) -> Callable[[int], AutomaticState]:
        """Return the state of the automatic controls as a function of the frame number of a static
        scene.

        Meters read the mean frame: they average over a frame, so that noise is small compared with
        the mean, and a frame follows from its number alone.
        """
        controls, states = AutomaticControls.of(self, conditions), [UNTOUCHED]
        cm2_s = at_mcp.values.size * self.cells.cell_area_cm2 * self.field_s
        video = self.description.video

        def next_state(state: AutomaticState) -> AutomaticState:
            output, signal_dn = 0.0, 0.0
            if controls.brightness is not None:
                output = (
                    self.chain(conditions, state)[Slot.MCP].mean(at_mcp).values.sum(dtype=float)
                    / cm2_s
                )
            if controls.gain is not None:
                level = np.minimum(
                    self.mean_frame(at_mcp, conditions, state), 2**video.bit_depth - 1
                )
                signal_dn = float(level.mean(dtype=float)) - float(video.black_level_dn)
            return controls.next(state, output, signal_dn)

        def state_of(frame: int) -> AutomaticState:
            if controls == AutomaticControls():
                return UNTOUCHED
            while len(states) <= frame:
                states.append(next_state(states[-1]))
            return states[frame]

        return state_of

    def is_sparse(self, at_mcp: StageImage) -> bool:
        """Whether there is so little light on `cells` that single pulses are seen, and drawn."""
        per_px = max(float(at_mcp.values.mean(dtype=float)), 0.0) * 4 * self.fields_per_frame
        return per_px < ACCURACY.sparse_pe_per_px

    def frames(
        self,
        at_mcp: StageImage,
        conditions: Conditions,
        *,
        seed: int,
        first_frame: int = 0,
        exact: bool = False,
        threads: int = 1,
    ) -> Frames:
        """Yield the frames of a static scene, shape (row, col), DN; never ends.

        Parameters
        ----------
        at_mcp
            Expected photoelectrons at the MCP input per cell and exposure, on `cells`.
        conditions
            Gate, voltage, temperature, and which automatic controls were on: these start untouched
            in frame 0.
        seed
            Seed of the run. A frame depends on it and on its own number alone.
        first_frame
            Number of the first frame.
        exact
            Whether every pulse is drawn: by the fast sampler, which does so where light is sparse,
            else stage by stage.
        threads
            Threads that share a frame of the fast sampler; frames do not depend on their number.
        """
        if not self.has_tube:
            # No stage remembers earlier frames.
            chain = self.chain(conditions)
            pixels, readout = chain[Slot.PIXELS].mean(at_mcp), chain.between(Slot.CCD, Slot.VIDEO)
            return (
                readout.draw(pixels, np.random.default_rng([seed, 1, frame])).values
                for frame in count(first_frame)
            )
        if not np.isfinite(at_mcp.values).all():
            raise BadInput("photoelectrons at the plate must be finite, got some that are not")
        if exact and not self.is_sparse(at_mcp):
            return self.chain_frames(at_mcp, conditions, seed=seed, first_frame=first_frame)
        sampler = FrameGenerator(
            self.chain(conditions), self.fields_per_frame, seed=seed, threads=threads
        )
        # A normal law of sums is one of many pulses.
        sparse = self.is_sparse(at_mcp) and "pulse-height distribution" not in self.left_out
        return sampler.static(
            at_mcp, self.automatic_state_of(at_mcp, conditions), first_frame, sparse=sparse
        )

    def chain_frames(
        self, at_mcp: StageImage, conditions: Conditions, *, seed: int, first_frame: int = 0
    ) -> Frames:
        """Yield the frames of a static scene drawn stage by stage; arguments as for `frames`.

        Notes
        -----
        Phosphor decay: the lag fields of a frame are drawn again. Pulses are drawn on cells one row
        high, in an early and a late half; what those cells blur away of the scene is added without
        noise, so that frames average to `mean_frame`.
        """
        fields, decay = self.fields_per_frame, self.stage(Slot.DECAY, conditions)
        states, coarse = self.automatic_state_of(at_mcp, conditions), at_mcp.in_whole_rows()
        halves = coarse.with_values(np.repeat(0.5 * coarse.values[None], 2, axis=0))

        @lru_cache(maxsize=2)
        def stages(state: AutomaticState) -> tuple[Chain, NDArray[np.float32], Chain]:
            chain = self.chain(conditions, state)
            screen = chain.between(Slot.MCP, Slot.PIXELS)
            finer = screen.mean(at_mcp).values - screen.mean(coarse).values
            # A map of the load must lie on the cells of the draw.
            plate = chain[Slot.MCP].under_load(coarse if self.local_depletion else at_mcp, parts=2)
            return screen.replacing(plate), finer, chain.between(Slot.SCAN, Slot.VIDEO)

        recent: deque[NDArray[np.float32]] = deque(maxlen=decay.n_lag_fields + fields)
        field = fields * first_frame - decay.n_lag_fields
        for frame in count(first_frame):
            for number in range(field, fields * (frame + 1)):
                pulses, _, _ = stages(states(max(number // fields, 0)))
                # Fields before the first frame, whose light it still shows, have numbers below
                # zero; seeds may not.
                recent.append(
                    pulses.draw(halves, np.random.default_rng([seed, 0, number + 1024])).values
                )
            field = fields * (frame + 1)
            _, finer, readout = stages(states(frame))
            shown = StageImage(values=apply_phosphor_decay(list(recent), decay.halves) + finer)
            yield readout.draw(shown, np.random.default_rng([seed, 1, frame])).values[0]

    def moving_frames(
        self,
        scenes: Iterable[StageImage],
        conditions: Conditions,
        *,
        seed: int,
        settled: bool = False,
    ) -> Frames:
        """Yield a frame, shape (row, col), DN, for every scene, or for every two where fields are
        interlaced.

        Parameters
        ----------
        scenes
            Expected photoelectrons at the MCP input per cell of `cells` and exposure, one for each
            exposure in the order of time, taken one frame at a time.
        conditions
            Gate, voltage, temperature, and which automatic controls were on.
        seed
            Seed of the run.
        settled
            Whether phosphor and channels start as after a long exposure to the first scene, else as
            after a rest.

        Notes
        -----
        Here a frame does depend on those before it: through the phosphor's decay, through depleted
        channels of a camera with local depletion, and through automatic controls. The first scene
        decides whether pulses are drawn singly.
        """
        sampler = FrameGenerator(
            self.chain(conditions), self.fields_per_frame, seed=seed, threads=1
        )
        controls = AutomaticControls.of(self, conditions)
        return sampler.moving(scenes, controls.next, is_sparse=self.is_sparse, settled=settled)
