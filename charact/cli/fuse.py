"""The verb `fuse`: one picture of a visible and a thermal frame with uncertainty, and its
scores.
"""

import json
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from charact import __version__
from charact.api import fusing
from charact.cli.options import Events, Json, of, verb
from charact.cli.output import (
    exit_on_bad_input,
    print_message,
    print_result,
    progress_bar,
)
from charact.cli.outputs import Force, require_free
from labdata.errors import BadInput
from labdata.file_io import require_folder_of


class _PicturesByDefault(TyperGroup):
    """Group whose first argument is a command or, otherwise, the first picture."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Insert the command `pictures` where none is named."""
        if args and args[0] not in self.commands and args[0] not in ("-h", "--help"):
            args = ["pictures", *args]
        return super().parse_args(ctx, args)


app = typer.Typer(
    cls=_PicturesByDefault,
    no_args_is_help=True,
    help=(
        "Fuse visible and thermal pictures: charact fuse visible.tif thermal.tif OUT; score one: "
        "charact fuse score."
    ),
)

Sources = Annotated[
    list[str],
    typer.Argument(
        help="Pictures, or SESSION#LABEL: VISIBLE THERMAL [MORE...] OUT; OUT is a new folder, "
        ".png or .tif. Frames of several sizes need descriptions of both cameras, or a simulated "
        "session."
    ),
]


@app.command()
@verb(fusing.fuse, print_result)
def pictures(sources: Sources, force: Force = False, **settings: Any) -> None:
    """Fuse pictures (default command).

    Writes fused.tif, fused.png, sd.tif, share.tif, mask.png, fused.json and each band as it was
    fused; of several methods one folder each, and index.html.

    Example: charact fuse visible.tif thermal.tif fused --sensor pulnix-ag5745ef3

    Example: charact fuse night#pulnix-ag5745ef3 night#vox-lwir-640 fused --method all
    """
    (*given, out), as_json, events = sources, settings["as_json"], settings["events"]
    with (
        exit_on_bad_input(" ".join(given), as_json=as_json, events=events),
        progress_bar(events=events) as progress,
    ):
        if len(given) < 2:
            raise BadInput(f"fuse needs VISIBLE THERMAL [MORE...] OUT, got {' '.join(sources)}")
        target, names = Path(out), settings["method"]
        several = len(set(names)) > 1 or "all" in names
        is_folder = several or settings["sequence"] or settings["table"] is not None
        _require_output(target, is_folder=is_folder, force=force)
        fusion = fusing.fuse(*given, progress=progress, **of(fusing.fuse, settings))
        fusion.save(target)
        progress("", 1.0)
        pictures = fusion.pictures
        first = target / next(iter(pictures)) if len(pictures) > 1 else target
        inputs = [target / f"{name}.png" for name in next(iter(pictures.values())).names[:2]]
        print_result(
            fusion.result,
            given=" ".join(given),
            verb="fuse",
            next_verb=None
            if target.suffix
            else f"charact fuse score {inputs[0]} {inputs[1]} {first / 'fused.png'}",
            **of(print_result, settings),
        )
        if not as_json:
            print_message(f"{target}: {', '.join(pictures)} of {', '.join(given)}", events=events)


def _require_output(out: Path, *, is_folder: bool, force: bool) -> None:
    """Require a new output; --force replaces a picture, or a folder that holds fused pictures."""
    from charact.fusion.files import PAGE, SETTINGS, require_place

    require_place(out, is_folder=is_folder, name="OUT")
    if out.suffix:
        require_folder_of(out)
        require_free(out, force=force, kept=lambda: None if out.is_file() else "a folder")
        return
    taken = out.exists() and (not out.is_dir() or any(out.iterdir()))
    is_ours = (out / SETTINGS).is_file() or (out / PAGE).is_file()
    other = None if is_ours else f"something without a {SETTINGS}"
    require_free(out, force=force, taken=taken, kept=lambda: other)


@app.command()
@verb(fusing.fusion_scores)
def score(
    visible: Annotated[Path, typer.Argument(help="Visible picture of 8 bits.")],
    thermal: Annotated[Path, typer.Argument(help="Thermal picture of 8 bits.")],
    fused: Annotated[Path, typer.Argument(help="Fused picture of 8 bits, grey or colour.")],
    as_json: Json = False,
    events: Events = False,
    **settings: Any,
) -> None:
    """Score a fused picture by eleven measures of the literature, each with a noise and a copy
    control.

    Example: charact fuse score visible.png thermal.png fused/fused.png
    """
    with exit_on_bad_input(str(fused), as_json=as_json, events=events):
        rows = fusing.fusion_scores(visible, thermal, fused, **settings)
        if as_json:
            document = {
                "charact": __version__,
                "input": str(fused),
                "scores": [row._asdict() for row in rows],
            }
            print(json.dumps(document, allow_nan=False))
            return
        print(f"{'score':24} {'value':>12} {'with noise':>12} {'copy':>12}  unit")
        for row in rows:
            columns = ("undefined" if value is None else f"{value:.5g}" for value in row[2:])
            texts = " ".join(f"{text:>12}" for text in columns)
            print(f"{row.quantity:24} {texts}  {row.unit}")
        print(
            "with noise: the fused picture plus noise of 10 DN; copy: the visible picture instead"
        )


@app.command()
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
        require_folder_of(out)
        require_free(out, force=force, kept=lambda: None if out.is_file() else "a folder")
        colours, names = fusing.fusion_colours(visible, thermal, scene)
        colours.save(out)
        print_message(f"{out}: colours of {len(names)} materials")
