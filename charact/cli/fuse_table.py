"""The verb `fuse table`: colours of visible and thermal values, from the materials of a simulated
session.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from charact.cli.output import exit_on_bad_input, print_message
from charact.cli.outputs import Force, require_free
from labdata.errors import BadInput

if TYPE_CHECKING:
    from charact.fusion.sources import Source

# Wavelengths whose reflectance is red, green and blue, nm, and the exponent of the display (IEC
# 61966-2-1, nearly).
COLOURS_NM, GAMMA = (610.0, 550.0, 465.0), 1.0 / 2.2
# Number of the sky in the truth, and its colour.
SKY, SKY_COLOUR = -1, (0.35, 0.45, 0.62)


def table(
    visible: Annotated[str, typer.Argument(help="SESSION#LABEL of the visible camera, simulated.")],
    thermal: Annotated[str, typer.Argument(help="SESSION#LABEL of the thermal camera.")],
    scene: Annotated[Path, typer.Argument(help="The scene: .toml, or name of a shipped one.")],
    out: Annotated[Path, typer.Argument(help="New .npz, for charact fuse --table.")],
    force: Force = False,
) -> None:
    """Make a table of daylight colours for charact fuse --table from the truth of a simulated
    session.

    Example: charact fuse table night#pulnix-ag5745ef3 night#vox-lwir-640 hangar colours.npz
    """
    with exit_on_bad_input(f"{visible} {thermal}"):
        if out.suffix != ".npz":
            raise BadInput(f"OUT must be an .npz, got {out.name!r}")
        require_free(out, force=force, kept=lambda: None if out.is_file() else "a folder")
        from charact.fitting.described_camera import describe_camera
        from charact.fusion.alignment import align_bands, common_field, crop_band
        from charact.fusion.colour_table import make_colour_table
        from charact.fusion.sources import band_of, read_source

        sources = [
            read_source(given, name, describe=describe_camera)
            for given, name in ((visible, "visible"), (thermal, "thermal"))
        ]
        bands, places = align_bands([band_of(source) for source in sources], sources)
        rows, cols = bands[0].image.shape
        region = row, col, height, width = common_field(places) or (0, 0, rows, cols)
        materials, names = _materials(sources[0])
        cut = materials[row : row + height, col : col + width]
        made = make_colour_table(
            [crop_band(band, region) for band in bands], cut, _colours(scene, names)
        )
        made.save(out)
        print_message(f"{out}: colours of {len(names)} materials")


def _materials(source: "Source") -> tuple[Any, list[str]]:
    """Return the number of the material that each pixel of the frame shows, and the names of the
    materials.
    """
    import numpy as np

    truth = source.truth_files.get(0)
    if truth is None or source.geometry is None:
        raise BadInput(
            f"a colour table needs the truth of a simulated session, got none of {source.name}"
        )
    with np.load(truth) as file:
        return source.geometry.on_frame(file["material"]), [str(name) for name in file["materials"]]


def _colours(scene: Path, names: list[str]) -> dict[int, tuple[float, float, float]]:
    """Return the daylight colour of each material of a scene, and of the sky, by the numbers of the
    truth.
    """
    import numpy as np

    from simulate.radiance.outdoor.scene import OutdoorScene
    from simulate.radiance.scene import load_scene

    loaded = load_scene(scene)
    if not isinstance(loaded, OutdoorScene):
        raise BadInput(f"a colour table needs an outdoor scene, got {scene}")
    by_label = {one.label: one for one in loaded.material}
    colours = {SKY: SKY_COLOUR}
    for number, name in enumerate(names):
        surface = by_label.get(name)
        # Panes show what is behind them, and measured surfaces have no one spectrum.
        if surface is not None and surface.measured is None and surface.pane_transmittance is None:
            red, green, blue = (
                np.clip(surface.material.reflectance_at(np.array(COLOURS_NM)), 0.0, 1.0) ** GAMMA
            )
            colours[number] = (float(red), float(green), float(blue))
    return colours
