"""The command run in this process, and what every refusal has in common."""

from typer.testing import CliRunner, Result

from charact.cli.application import app


def charact(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(a) for a in arguments])


def done_well(*arguments: object) -> Result:
    done = charact(*arguments)
    assert done.exit_code == 0, done.output
    return done


def assert_one_sentence(done: Result, *words: str) -> None:
    assert done.exit_code == 1, done.output
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    sentence = done.stderr.strip()
    assert len(sentence.splitlines()) == 1, sentence
    assert "Traceback" not in done.output
    for word in words:
        assert word in sentence, sentence
