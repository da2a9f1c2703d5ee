"""Views of an outdoor scene whose camera or objects move, at one time after the other.

A view is rendered anew only at times at which camera or objects stand otherwise than at the time
before, with what the first view found (bands, rays, effects to leave out) and with other random
numbers. Light, weather and the temperatures of surfaces are those of the scene's time. Within one
exposure the scene stands still.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from simulate.infrared_view import InfraredView
    from simulate.outdoor_rendering import RenderedView
    from simulate.radiance.outdoor.scene import OutdoorScene


@dataclass(frozen=True, kw_only=True)
class Look:
    """A view, and what a camera has of it: photoelectrons at its MCP or in its chip, or the signal
    of an imager.
    """

    view: "RenderedView | InfraredView"
    light: Any


@dataclass(frozen=True, kw_only=True)
class Motion:
    """A moving scene before one camera.

    Parameters
    ----------
    scene, sensor
        The scene with its keyframes, and the camera's name in its rig.
    look
        Renders a scene that stands still, with a seed.
    seed
        Seed of the first view.
    """

    scene: "OutdoorScene"
    sensor: str | None
    look: "Callable[[OutdoorScene, int], Look]"
    seed: int

    def at(self, time_s: float) -> "OutdoorScene":
        """Return the scene as it stands before the camera at a time after the scene's, s."""
        return self.scene.at(time_s).for_sensor(self.sensor)

    def is_still(self, times_s: Iterable[float]) -> bool:
        """Whether nothing moves from one of the times to another."""
        first_s, *later_s = times_s
        start = self.at(first_s)
        return all(self.at(time_s) == start for time_s in later_s)

    def looks(self, first: Look, times_s: Iterable[float]) -> Iterator[Look]:
        """Yield the look at each time, the same one while nothing moves; `first` is that at the
        first time.
        """
        look, previous_scene = first, None
        for number, time_s in enumerate(times_s):
            scene = self.at(time_s)
            if previous_scene is not None and scene != previous_scene:
                look = self.look(
                    scene, int(np.random.SeedSequence([self.seed, number]).generate_state(1)[0])
                )
            previous_scene = scene
            yield look
