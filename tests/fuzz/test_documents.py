"""Mangled documents give one sentence or nothing: never another exception, never a hang."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labdata import BadInput
from tests.fuzz import documents
from tests.fuzz.bounds import in_time

unhurried = settings(deadline=None, derandomize=True, max_examples=80)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return documents.prepared(tmp_path_factory.mktemp("fuzz"))


@pytest.mark.parametrize("target", documents.TARGETS)
def test_the_documents_are_sound_before_they_are_mangled(target, folder):
    sound = documents.sound(target)
    assert all(documents.read(target, document, folder) for document in sound)


@pytest.mark.parametrize("target", documents.TARGETS)
def test_a_mangled_document_is_refused_in_a_sentence_or_read(target, folder):
    sound = documents.sound(target)

    @unhurried
    @given(st.integers(0, 2**32), st.sampled_from(range(len(sound))))
    def look(seed: int, which: int) -> None:
        with in_time():
            documents.read(target, documents.mangled(sound[which], random.Random(seed)), folder)

    look()


@unhurried
@given(
    st.sampled_from(sorted(documents.TARGETS)),
    st.binary(max_size=300) | st.text(max_size=300).map(str.encode),
)
def test_any_bytes_are_refused_in_a_sentence_or_read(folder, target, document):
    with in_time():
        documents.read(target, document, folder)


FOUND = {
    "brackets": (b'name = "p"\nstep = ' + b"[" * 3000, "nested too deep"),
    "digits": (b'name = "p"\nseed = 1' + b"0" * 5000, "thousands of digits"),
    "date": (
        b'name = "s"\n[[step]]\nlabel = 1979-05-27T07:32:00Z\nkind = "dark"\nframes = "x"',
        "must be",
    ),
    "union": (
        b'name = "p"\n[[sweep]]\nkind = "flat"\nframes = 1\ntarget = { value = 1 }',
        "unknown key 'value' in target",
    ),
    "path": (
        b'name = "p"\nsensor = "'
        + b"x" * 5000
        + b'"\n[[step]]\nlabel = "a"\nkind = "dark"\nframes = 1',
        "a sensor",
    ),
    "frames": (
        b'name = "p"\nsensor = "pulnix-ag5745ef3"\n[[step]]\nlabel = "a"\nkind = "dark"\nframes = '
        + b"9" * 400,
        r"the disk must have \d+ MB free",
    ),
    "sweeps": (
        b'name = "p"\n' + b'[[sweep]]\nkind = "dark"\nframes = 1\nrepeats = 20000\n' * 9,
        "at most 20000 steps",
    ),
}


@pytest.mark.parametrize("found", FOUND)
def test_what_was_found_before_stays_refused(found, folder):
    document, words = FOUND[found]
    path = folder / "plan.toml"
    path.write_bytes(document)
    with pytest.raises(BadInput, match=words):
        documents.TARGETS["plan"][0](path)


def test_the_least_voltage_that_a_number_can_hold_has_a_forecast(folder):
    assert documents.read(
        "plan", b"mcp_v = 5e-324\n".join(documents.SWEPT.split(b"mcp_v = 700.0\n")), folder
    )


def test_a_descriptor_with_an_image_that_no_file_can_be_called_is_refused_in_a_sentence(folder):
    for name in (b"a\0.npy", b"x" * 5000 + b".npy"):
        assert not documents.read(
            "EMVA 1288 descriptor", b"v 4.0\nn 12 4 4\nd 1\ni " + name + b"\ni a.npy\n", folder
        )


def test_a_ledger_with_a_line_of_nothing_but_brackets_is_refused_in_a_sentence(folder):
    assert not documents.read(
        "ledger", documents.sound("ledger")[0] + b"[" * 100_000 + b"\n", folder
    )
