"""Parallel reading of stacks in parts."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from charact.method import Context
from charact.noise.cube.cube import Cube, cube_of
from charact.noise.stack.exposure_order import runs_of
from charact.noise.stack.frame_block import FrameBlock, run_of
from charact.noise.stack.stack_statistics import StackStatistics, stack_statistics
from labdata.errors import BadInput
from labdata.frames import FrameStack
from labdata.lazy_stack import LazyStack, open_lazy_stack
from labdata.session import StackEntry

# Largest stack that is read at once; of a larger one each block is a part, and the cube another.
WHOLE_BYTES = 128 * 2**20


@dataclass(frozen=True, kw_only=True)
class Part:
    """Task: some of the statistics of a stack.

    Parameters
    ----------
    entry
        The stack.
    runs
        First and last-plus-one frame of each block.
    cube
        Whether to compute 3-D noise.
    spectra
        Whether to compute noise spectra.
    context
        Settings.
    whole
        Whether to read the complete stack at once.
    """

    entry: StackEntry
    runs: tuple[tuple[int, int], ...]
    whole: bool
    cube: bool
    spectra: bool
    context: Context


@dataclass(frozen=True, kw_only=True)
class PartStatistics:
    """Statistics of a part."""

    runs: tuple[FrameBlock, ...]
    cube: Cube | None


def read_levels_of(
    entries: Sequence[StackEntry], *, context: Context, spectra: bool = True, cubes: bool = False
) -> list[StackStatistics | None]:
    """Return the statistics of stacks; None for a stack of a single frame.

    Parameters
    ----------
    entries
        The stacks.
    context
        Settings; `context.spread` maps over the parts.
    spectra, cubes
        Whether to compute noise spectra and 3-D noise.

    Raises
    ------
    BadInput
        If frame numbers repeat, values are out of range, or a frame has too few rows for two fields.
    """
    alone = replace(context, progress=Context.progress, spread=Context.spread)
    # Workers run in other folders.
    entries = [replace(entry, folder=entry.folder.absolute()) for entry in entries]
    parts, shapes = [], []
    for entry in entries:
        stack = open_lazy_stack(entry)
        shapes.append(stack.shape)
        parts.append(_parts(entry, stack, alone, spectra, cubes))
    found = iter(context.spread(part_statistics, [part for of_stack in parts for part in of_stack]))
    levels: list[StackStatistics | None] = []
    for entry, shape, of_stack in zip(entries, shapes, parts, strict=True):
        context.progress(f"noise of {entry.label}", len(levels) / len(entries))
        levels.append(_join_parts(entry, shape, islice(found, len(of_stack)), context))
    return levels


def part_statistics(part: Part) -> PartStatistics:
    """Read the frames of a part and return its statistics."""
    stack = open_lazy_stack(part.entry)
    if part.whole:
        stack = stack.in_memory()
    try:
        runs = tuple(
            run_of(_frames(stack, first, last), context=part.context, spectra=part.spectra) for first, last in part.runs
        )
    except BadInput as error:
        raise BadInput(f"{error}, in stack {part.entry.label!r}") from None
    return PartStatistics(runs=runs, cube=cube_of(stack, context=part.context) if part.cube else None)


def _parts(entry: StackEntry, stack: LazyStack, context: Context, spectra: bool, cube: bool) -> list[Part]:
    """Return the parts of a stack."""
    number = stack.frame_number
    if len(np.unique(number)) < len(number):
        raise BadInput(f"frame numbers of {entry.label} must be unique, got {number.tolist()[:8]}")
    if len(stack) < 2:
        return []
    runs = tuple(runs_of(stack))
    every = Part(entry=entry, runs=runs, cube=cube, spectra=spectra, context=context, whole=True)
    if stack.size_bytes <= WHOLE_BYTES:
        return [every]
    parts = [replace(every, runs=(run,), cube=False, whole=False) for run in runs]
    return [*parts, replace(every, runs=(), whole=False)] if cube else parts


def _join_parts(entry: StackEntry, shape: tuple[int, int, int], found: Iterable[PartStatistics], context: Context
              ) -> StackStatistics | None:  # fmt: skip
    """Return the statistics of a stack from those of its parts."""
    parts = list(found)
    runs = [run for part in parts for run in part.runs]
    cube = next((part.cube for part in parts if part.cube is not None), None)
    return stack_statistics(entry, runs, cube, shape=shape, context=context) if runs else None


def read_stack_frames(entry: StackEntry) -> FrameStack:
    """Read all frames of a stack."""
    stack = open_lazy_stack(entry)
    return _frames(stack, 0, len(stack))


def _frames(stack: LazyStack, first: int, last: int) -> FrameStack:
    """Return the frames of one block."""
    stamped = len(stack.frame_number) == len(stack)
    number = stack.frame_number[first:last] if stamped else np.arange(first, last)
    return FrameStack(data=stack.frames(first, last), frame_number=number, full_scale_dn=stack.full_scale_dn)
