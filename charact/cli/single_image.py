"""A single image in place of a session: measured where one frame is sufficient, else refused."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from charact.cli.output import exit_on_bad_input, print_result, progress_bar

if TYPE_CHECKING:
    from charact.mtf.mean_frame import Region
    from labdata.frames import FrameStack
    from labdata.measurement import Result
    from labdata.session import Session


def is_image(path: Path) -> bool:
    """Whether a path is a file of frames, not a session."""
    from labdata.importers import module_of
    from labdata.session import MANIFEST

    return module_of(path) is not None and not (path / MANIFEST).is_file()


def region_in(stack: "FrameStack", region: "Region | None") -> "Region | None":
    """Return a region of the file in coordinates of the frames, whose border may have been cropped."""
    return None if region is None else (region[0] - stack.origin[0], region[1] - stack.origin[1], *region[2:])


def in_file_coordinates(result: "Result", stack: "FrameStack") -> "Result":
    """Return the result with regions in coordinates of the file and with the notes of the importer."""
    from charact.mtf.dispatch import REGION_NAME
    from labdata.measurement import Result

    def shift_region(region: "Region") -> "Region":
        return region[0] + stack.origin[0], region[1] + stack.origin[1], region[2], region[3]

    measurements = tuple(
        m.with_(
            region=None if m.region is None else shift_region(m.region),
            notes=tuple(dict.fromkeys((*m.notes, *stack.notes))),
        )
        for m in result.measurements
    )
    names = {
        REGION_NAME.format(*m.region): REGION_NAME.format(*shift_region(m.region))
        for m in result.measurements
        if m.region
    }

    def rename_curve(name: str) -> str:
        here = next((suffix for suffix in names if name.endswith(suffix)), None)
        return name if here is None else name.removesuffix(here) + names[here]

    return Result(
        measurements=measurements,
        curves={rename_curve(name): curve for name, curve in result.curves.items()},
        evidence={rename_curve(name): shown for name, shown in result.evidence.items()},
    )


def require_session(path: Path) -> None:
    """Raise BadInput if the path is a file of frames."""
    from labdata.errors import BadInput

    if is_image(path):
        raise BadInput(
            f"a session must be a folder with a session.toml, got the file {path}; create one with charact import "
            f"frames {path} OUT --kind KIND, or use charact bloom or charact mtf"
        )


def open_session_only(path: Path) -> "Session":
    """Open a session; a file of frames raises BadInput."""
    from labdata.session import open_session

    require_session(path)
    return open_session(path)


def bloom_of_image(path: Path, *, method: str, within: float, quick: bool, seed: int, mapped: bool,
                     plane: str | None, axis: str | None, as_json: bool, events: bool) -> None:  # fmt: skip
    """Measure and print the bloom extent of a point source in a single image."""
    with exit_on_bad_input(str(path), as_json=as_json, events=events):
        from charact import bloom
        from charact.bloom.single_frame import bare_session, measure_frame
        from charact.session_measurement import method_context
        from labdata.errors import BadInput

        if not path.exists():
            raise BadInput(f"the file of frames must exist, got {path}")
        if mapped:
            raise BadInput(
                f"--map needs a session with point sources, got the file {path}; create one with "
                f"charact import frames {path} OUT --kind point"
            )
        session = bare_session(path)
        session = replace(session, stacks=(replace(session.stacks[0], plane=plane, axis=axis),))
        with progress_bar(events=events) as progress:
            context = method_context(session, quick=quick, seed=seed, progress=progress)
            if method == "auto":
                result = measure_frame(session, context=context)
            else:
                result = bloom.measure(session, method=method, within_percent=within, context=context)
        result = in_file_coordinates(result, session.stacks[0].read())
        further = f"charact import frames {path} mine --kind point, then charact measure mine"
        print_result(result, given=str(path), as_json=as_json, events=events, next_verb=further)
