"""The verb `watch`: each stack of a running plan measured as it lands, one line a stack."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from charact import __version__
from charact.cli import options
from charact.cli.output import exit_on_bad_input, number_of, print_message
from charact.cli.single_image import require_session
from labdata.errors import BadInput

if TYPE_CHECKING:
    from charact.live.quick_look import QuickLook
    from labdata.measurement import Measurement


def add_to(app: typer.Typer) -> None:
    """Add the verb to the command."""
    app.command()(watch)


def watch(
    session: Annotated[Path, typer.Argument(help="Folder of a session that grows while a plan runs.")],
    once: Annotated[bool, typer.Option("--once", help="End with the stacks that are there now.")] = False,
    patience_s: Annotated[
        float, typer.Option("--patience-s", help="Longest wait for the next stack, s.", min=0.0)
    ] = 1800.0,
    seed: options.Seed = 0,
    as_json: options.Json = False,
    events: options.Events = False,
) -> None:
    """Each stack measured as it lands, one line a stack; ends with the run.

    With --json each stack is one JSON object a line. What is distrusted is named: saturation, drift, automatic gain.

    Example: charact watch day1
    """
    interrupted = f"watched no more; the run goes on: charact watch {session}"
    with exit_on_bad_input(str(session), as_json=as_json, events=events, interrupted=interrupted):
        from charact.live.quick_look import look_at
        from charact.live.stack_watcher import watch_stacks

        require_session(session)
        for so_far, entry in watch_stacks(session, once=once, patience_s=patience_s):
            try:
                looked = look_at(so_far, entry, seed=seed)
            except BadInput as error:
                print_message(f"{entry.label}: {error}", events=events)
                continue
            print(json.dumps(_object(looked)) if as_json else _line(looked), flush=True)


def _line(looked: "QuickLook") -> str:
    """Return a stack's line: level, losses, saturation, numbers with intervals, and what to distrust."""
    entry = looked.entry
    level = (
        f"{entry.label} ({entry.kind}): {looked.frames} frames, {entry.lost_frames} lost, "
        f"mean {looked.mean_dn:.4g} DN, at most {looked.saturated_px} px at {looked.full_scale_dn:g} DN"
    )
    numbers = [
        f"{_name(m, looked.leading)} {number_of(m)}" + ("" if m.value is not None else f": {m.reason}")
        for m in looked.leading
    ]
    flags = dict.fromkeys(flag for m in looked.leading for flag in m.flags)
    return "; ".join([level, *numbers, *([f"distrust: {', '.join(flags)}"] if flags else [])])


def _name(m: "Measurement", among: "tuple[Measurement, ...]") -> str:
    """Return a quantity with its frequency, and with its direction where another has the same name."""
    at = "" if m.frequency_cy_per_px is None else f" at {m.frequency_cy_per_px:.3g} cy/px"
    several = sum(other.quantity == m.quantity for other in among) > 1 and m.orientation_deg is not None
    return m.quantity + at + (f" along {m.orientation_deg:.3g} deg" if several else "")


def _object(looked: "QuickLook") -> dict:
    from labdata.result_io import to_json

    return {
        **to_json(looked.result, given=looked.entry.label, version=__version__),
        "stack": looked.entry.label,
        "kind": looked.entry.kind,
        "frames": looked.frames,
        "lost_frames": looked.entry.lost_frames,
        "mean_dn": looked.mean_dn,
        "most_saturated_px": looked.saturated_px,
        "full_scale_dn": looked.full_scale_dn,
    }
