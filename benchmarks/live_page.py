"""The live page in a real browser: how often it updates, who is refused, and its pictures to be
looked at.
"""

import http.server
import json
import re
import select
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from benchmarks.chromium import Chromium, program

LEAST_HZ = 10.0
MEASURED_S = 20.0
READY_S = 90.0
NAMES_ITSELF_AS_US = "rebound.example"
EVERYWHERE = "0.0.0.0"
READ = """
(async () => {
  const tried = {};
  try { tried.fetch = (await fetch("%(page)s/view.json")).status; }
  catch (error) { tried.fetch = "refused"; }
  try { await fetch("%(page)s/view.json", {mode: "no-cors"}); tried.opaque = "sent"; }
  catch (error) { tried.opaque = "refused"; }
  tried.events = await new Promise((done) => {
    const stream = new EventSource("%(page)s/events");
    stream.addEventListener("about", () => { stream.close(); done("READ"); });
    stream.addEventListener("error", () => { stream.close(); done("refused"); });
  });
  tried.script = await new Promise((done) => {
    const script = document.createElement("script");
    script.src = "%(page)s/live.js";
    script.onload = () => done("READ"); script.onerror = () => done("refused");
    document.head.append(script);
  });
  return tried;
})()
"""


def main(out: Path) -> int:
    """Run every check, write the screenshots into a folder, and return the exit code."""
    if program() is None:
        print("live-check skipped: Chromium is not installed (Debian: apt-get install chromium)")
        return 0
    out.mkdir(parents=True, exist_ok=True)
    good = []
    with _live("live") as address:
        good += [_rates(address, out), *_strangers(address)]
    with _live("focus") as address:
        _pictures(address, out)
    good += _tokens()
    print(f"screenshots to be looked at: {out}")
    return 0 if all(good) else 1


def _rates(address: str, out: Path) -> bool:
    with Chromium() as browser:
        browser.size(1280, 900)
        browser.open(address)
        _until(browser, "document.body.dataset.pictures > 30")
        before, began = _counts(browser), time.monotonic()
        time.sleep(MEASURED_S)
        after, took_s = _counts(browser), time.monotonic() - began
        browser.screenshot(out / "live.png")
        rates = {name: (after[name] - before[name]) / took_s for name in before}
        frame_hz = browser.evaluate("document.getElementById('rate').textContent")
    told = ", ".join(f"{name} {rate:.1f}/s" for name, rate in rates.items())
    print(f"updates over {took_s:.0f} s: {told} (at least {LEAST_HZ:g}); camera {frame_hz}")
    return min(rates.values()) >= LEAST_HZ


def _strangers(address: str) -> Iterator[bool]:
    """Whether a page of another origin, and one whose name was made to lead to us, are refused."""
    page = address.rstrip("/")
    port = int(page.rsplit(":", 1)[1])
    with (
        _other_origin() as elsewhere,
        Chromium(f"--host-resolver-rules=MAP {NAMES_ITSELF_AS_US} 127.0.0.1") as browser,
    ):
        browser.open(elsewhere)
        tried = browser.evaluate(READ % {"page": page})
        refused = tried["fetch"] == "refused" and tried["events"] == tried["script"] == "refused"
        print(f"from another origin: {tried} {'ok' if refused else 'WRONG'}")
        yield refused
        browser.open(f"http://{NAMES_ITSELF_AS_US}:{port}/view.json")
        text = browser.evaluate("document.body.innerText")
        refused = "mean_dn" not in text and NAMES_ITSELF_AS_US in text
        print(
            f"under a name made to lead here (DNS rebinding): {text!r} "
            f"{'ok' if refused else 'WRONG'}"
        )
        yield refused


def _pictures(address: str, out: Path) -> None:
    with Chromium() as browser:
        browser.size(1280, 900)
        browser.open(address)
        _until(browser, "document.getElementById('mtf50').textContent.length > 3")
        time.sleep(8.0)
        browser.screenshot(out / "focus.png")
        browser.evaluate("document.getElementById('red').click()")
        time.sleep(0.5)
        browser.screenshot(out / "focus-red.png")


def _tokens() -> Iterator[bool]:
    """Whether a page that others could reach is read with its token and not without, asked from
    this machine itself.
    """
    with _live("live", "--host", EVERYWHERE) as printed, Chromium() as browser:
        address = re.sub(r"//[^:]+:", "//127.0.0.1:", printed)
        page, _, token = address.partition("?token=")
        answers = {}
        for name, asked in {
            "none": page,
            "wrong": f"{page}?token={'x' * len(token)}",
            "right": address,
        }.items():
            browser.open(asked)
            answers[name] = browser.evaluate(
                "document.title + '|' + document.body.innerText.slice(0, 60)"
            )
        seen = _until(browser, "document.body.dataset.pictures > 3")
        hidden = token not in browser.evaluate("location.href + document.cookie")
    good = seen and hidden and all("needs the token" in answers[name] for name in ("none", "wrong"))
    print(
        f"not on the loopback: without token {answers['none']!r}, wrong {answers['wrong']!r}, "
        f"right: {'pictures' if seen else 'NO pictures'}, token "
        f"{'gone from' if hidden else 'STILL IN'} the address {'ok' if good else 'WRONG'}"
    )
    yield good


def _until(browser: Chromium, condition: str, *, timeout_s: float = READY_S) -> bool:
    until_s = time.monotonic() + timeout_s
    while time.monotonic() < until_s:
        if browser.evaluate(condition):
            return True
        time.sleep(0.2)
    raise TimeoutError(f"the page must come to {condition} within {timeout_s:g} s, it did not")


def _counts(browser: Chromium) -> dict[str, int]:
    return {
        name: int(value)
        for name, value in json.loads(
            browser.evaluate("JSON.stringify(Object.assign({}, document.body.dataset))")
        ).items()
    }


@contextmanager
def _live(verb: str, *options: str) -> Iterator[str]:
    """Yield the address of `charact live` or `charact focus` on the virtual bench."""
    code = "from charact.cli import main; main()"
    command = [sys.executable, "-c", code, verb, "--port", "0", *options]
    process = subprocess.Popen(
        command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True
    )
    try:
        yield _printed_address(process)
    finally:
        process.terminate()
        process.wait(timeout=READY_S)


def _printed_address(process: subprocess.Popen) -> str:
    assert process.stderr is not None
    heard, until_s = "", time.monotonic() + READY_S
    while time.monotonic() < until_s:
        ready, _, _ = select.select([process.stderr], [], [], 1.0)
        line = process.stderr.readline() if ready else ""
        heard += line
        if found := re.search(r"http://\S+", line):
            return found.group()
        if process.poll() is not None:
            break
    raise TimeoutError(f"charact must print its address within {READY_S:g} s, got {heard!r}")


@contextmanager
def _other_origin() -> Iterator[str]:
    """Yield the address of a page that is not ours, at another port."""

    class Stranger(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("content-type", "text/html")
            self.end_headers()
            self.wfile.write(b"<!doctype html><title>stranger</title>")

        def log_message(self, format: str, *args: object) -> None:
            """Nothing."""

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Stranger)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/"
    finally:
        server.shutdown()
        server.server_close()


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1] if len(sys.argv) > 1 else "live-check")))
