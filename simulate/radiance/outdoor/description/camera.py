"""Where a scene's camera stands and looks: a table of the scene's file."""

from dataclasses import dataclass

from labdata.errors import BadInput
from simulate.radiance.outdoor.viewpoint import RasterGeometry


@dataclass(frozen=True, kw_only=True)
class SceneCamera:
    """Where the camera stands; its lens and pixels are the sensor's.

    Parameters
    ----------
    position_m
        Place of the lens (east, north, up), m.
    look_at_m
        A place on its axis, m.
    roll_deg
        Turn about the axis, clockwise as the camera sees it, deg.
    distortion_fraction
        Radial distortion of the rays at the corner; the sensor's lens has its own, so it is 0 unless a cube is made for
        something else.
    scan
        Motion of a line scanner; without it the camera frames.
    """

    position_m: tuple[float, float, float]
    look_at_m: tuple[float, float, float]
    roll_deg: float = 0.0
    distortion_fraction: float = 0.0
    scan: RasterGeometry | None = None

    def __post_init__(self) -> None:
        if self.position_m == self.look_at_m:
            raise BadInput(f"a camera must look at another place than it stands, got {list(self.position_m)} for both")
