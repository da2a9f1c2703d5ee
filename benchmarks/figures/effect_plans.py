"""Writes into docs/explanation/simulator.md the bounds on each effect for the tutorial's card, lit
and dim.
"""

import re
from pathlib import Path

import numpy as np

from benchmarks.figures.lab_card import luminance
from labdata import Conditions, load_sensor
from simulate.camera.effect_bounds import select_camera_effects
from simulate.camera.scene_to_photoelectrons import (
    camera_from_description,
    photoelectrons_from_image,
)

PAGE = Path("docs/explanation/simulator.md")
CAMERA = "pulnix-ag5745ef3"
BRIGHT_PE, DIM_PE = 10.8, 0.1


def main() -> None:
    """Rewrite the page's two plans."""
    card = luminance()
    text = PAGE.read_text()
    for name, picture in (("lamp", BRIGHT_PE * card), ("dim", DIM_PE * np.minimum(card, 1.0))):
        text = printed(text, name, plan(picture))
    PAGE.write_text(text)


def plan(image_pe: np.ndarray) -> str:
    """Return the plan for a picture in photoelectrons per pixel and field, as a table for
    people.
    """
    camera = camera_from_description(load_sensor(CAMERA))
    return select_camera_effects(camera, photoelectrons_from_image(camera, image_pe), Conditions())[
        1
    ].text()


def printed(page: str, name: str, text: str) -> str:
    """Return a page with a text between the lines that bear its name."""
    begin, end = f"<!-- plan {name} -->", f"<!-- end {name} -->"
    new, found = re.subn(
        f"{begin}.*?{end}", f"{begin}\n```\n{text}\n```\n{end}", page, flags=re.DOTALL
    )
    if found != 1:
        raise ValueError(f"{PAGE.name} must hold the plan {name!r} once, got it {found} times")
    return new


if __name__ == "__main__":
    main()
