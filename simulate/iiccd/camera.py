"""Intensified camera: the stages of a description as one chain, its mean frame and its frames."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from labdata.conditions import Conditions
from simulate.iiccd import tube_photometry
from simulate.iiccd.automatic_controls import AutomaticState
from simulate.iiccd.chain import Chain, Stage
from simulate.iiccd.pixels import Collection, FieldReadout
from simulate.iiccd.stage_image import StageImage
from simulate.iiccd.stages_from_description import DescribedCamera


@dataclass(frozen=True)
class IntensifiedCamera(DescribedCamera):
    """An image-intensified camera built from its description, whose parameters are those of `DescribedCamera`.

    Automatic gain and brightness control are off, as they are for any measurement, unless the conditions say that they
    were on.
    """

    def chain(self, conditions: Conditions, *, cathode_lux: float = 0.0) -> Chain:
        """Return the complete chain under conditions; its input is in photons per s and cell, see `photocathode`.

        Parameters
        ----------
        conditions
            Gate, voltage or control word, and temperature.
        cathode_lux
            Illuminance averaged over the cathode and over time, lux of 2856 K light that would draw the same current:
            protection from bright sources lowers the gap's voltage with it.
        """
        stages: tuple[Stage, ...] = (
            self.optics(),
            self.photocathode(conditions),
            self.gap(cathode_lux),
            *((self.fibre_geometry(),) if self.geometry and "fibre geometry" not in self.left_out else ()),
            self.mcp(conditions),
            self.phosphor(),
            self.taper(),
            Collection(row_pairs=self.is_interlaced),
            self.afterglow(conditions),
            FieldReadout(interlaced=self.is_interlaced),
            self.ccd(conditions),
            self.video(conditions),
        )
        return Chain(stages)

    def photoelectrons(self, photons_per_s: StageImage, conditions: Conditions) -> StageImage:
        """Return the expected photoelectrons from the cathode, per cell and exposure.

        Parameters
        ----------
        photons_per_s
            Photons per s and cell on `scene_cells`, referred to the wavelength of peak efficiency.
        conditions
            Gate.
        """
        return replace(self.photocathode(conditions), ebi_per_s_cm2=0.0).mean(photons_per_s)

    def mcp_input(self, photons_per_s: StageImage, conditions: Conditions) -> StageImage:
        """Return the expected photoelectrons at the MCP input, per cell and exposure, for photons on the cathode.

        Arguments as for `photoelectrons`; dark photoelectrons are added.
        """
        return self.to_mcp_input(self.photoelectrons(photons_per_s, conditions), conditions)

    def cathode_lux(self, photoelectrons: StageImage) -> float:
        """Mean illuminance of 2856 K light over cathode and time, from photoelectrons per cell and exposure, lux."""
        per_s_cm2 = photoelectrons.values.mean(dtype=float) / self.scene_cells.cell_area_cm2 / self.field_s
        return per_s_cm2 / (tube_photometry.photoelectrons_per_lumen_s(self.sensor) * 1e-4)

    def to_mcp_input(self, photoelectrons: StageImage, conditions: Conditions) -> StageImage:
        """Return the expected photoelectrons at the MCP input for the photoelectrons of one exposure.

        Parameters
        ----------
        photoelectrons
            Per cell and exposure, on `scene_cells`; dark ones are added.
        conditions
            Gate and temperature.
        """
        cathode = self.photocathode(conditions)
        lux = self.cathode_lux(photoelectrons)
        dark = np.float32(cathode.ebi_per_s_cm2 * cathode.open_s * self.scene_cells.cell_area_cm2)
        behind = (
            self.chain(conditions, cathode_lux=lux).between("gap", "microchannel plate").without("microchannel plate")
        )
        return behind.mean(photoelectrons.with_values(photoelectrons.values + dark))

    def automatic_states(
        self, at_mcp: StageImage, conditions: Conditions, state: AutomaticState | None = None
    ) -> Iterator[AutomaticState]:
        """Yield the states of the automatic controls in frames 0, 1, ... of a static scene; never ends.

        Parameters
        ----------
        at_mcp
            Expected photoelectrons at the MCP input per cell and exposure, on `cells`.
        conditions
            Which controls were on, besides gate, voltage and temperature.
        state
            Where they stand in frame 0; both untouched if None.

        Notes
        -----
        Meters read the mean frame: they average over a frame, so that noise is small compared with the mean, and a
        frame follows from its number alone."""
        control, gain = self.brightness_control(conditions), self.automatic_gain(conditions)
        state = AutomaticState() if state is None else state
        cm2_s = at_mcp.values.size * self.cells.cell_area_cm2 * self.field_s
        while True:
            yield state
            brightness, factor = 1.0, 1.0
            if control is not None:
                output = self.mcp_to_pixels(conditions, state).stages[0].mean(at_mcp).values.sum(dtype=float) / cm2_s
                brightness = control.next(state.brightness, output)
            if gain is not None:
                level = np.minimum(self.mean_frame(at_mcp, conditions, state), 2**self.sensor.video.bit_depth - 1)
                above = float(level.mean(dtype=float)) - float(self.sensor.video.black_level_dn)
                factor = gain.next(state.gain, above)
            state = AutomaticState(brightness=brightness, gain=factor)

    def automatic_state_of(self, at_mcp: StageImage, conditions: Conditions) -> Callable[[int], AutomaticState]:
        """Return the state of the automatic controls as a function of the frame number of a static scene."""
        if not (conditions.automatic_gain or conditions.brightness_control):
            return lambda frame: AutomaticState()
        coming = self.automatic_states(at_mcp, conditions)
        known: list[AutomaticState] = []

        def state_of(frame: int) -> AutomaticState:
            while len(known) <= frame:
                known.append(next(coming))
            return known[frame]

        return state_of

    def mean_frame(
        self, at_mcp: StageImage, conditions: Conditions, state: AutomaticState | None = None
    ) -> NDArray[np.float32]:
        """Return the noiseless frame of a static scene, shape (row, col), DN.

        Parameters
        ----------
        at_mcp
            Expected photoelectrons at the MCP input per cell and exposure, on `cells`.
        conditions
            Gate, voltage and temperature.
        state
            Where the automatic controls stand; untouched if None.
        """
        pixels = self.mcp_to_pixels(conditions, state).mean(at_mcp)
        steady = pixels.with_values(np.repeat(pixels.values[None], self.fields_per_frame, axis=0))
        return self.readout(conditions, state).mean(steady).values[0]

    def frames(
        self, at_mcp: StageImage, conditions: Conditions, *, seed: int, first_frame: int = 0
    ) -> Iterator[NDArray[np.unsignedinteger]]:
        """Yield the frames of a static scene with the default sampler, see `sampler_choice.generate_frames`.

        A frame depends on the seed and its own number alone. Automatic controls that were on start untouched in frame 0
        and settle from there.
        """
        from simulate.iiccd import sampler_choice

        return sampler_choice.generate_frames(self, at_mcp, conditions, seed=seed, first_frame=first_frame)

    def mcp_to_pixels(self, conditions: Conditions, state: AutomaticState | None = None) -> Chain:
        """Return the chain from the MCP to the pixels in a state of the brightness control."""
        screen = self.chain(conditions).between("microchannel plate", "pixels")
        if state is None or state.brightness == 1.0:
            return screen
        plate = self.mcp(conditions)
        return Chain((replace(plate, gain=plate.gain * state.brightness), *screen.stages[1:]))

    def readout(self, conditions: Conditions, state: AutomaticState | None = None) -> Chain:
        """Return the chain from the scan to the digitiser in a state of the automatic gain."""
        readout = self.chain(conditions).between("scan", "video")
        if state is None or state.gain == 1.0:
            return readout
        video = self.video(conditions)
        return Chain((*readout.stages[:-1], replace(video, gain=video.gain * state.gain)))
