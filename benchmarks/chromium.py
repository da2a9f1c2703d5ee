"""A headless Chromium driven over its own pipe: enough to open a page, ask it something and take
its picture.
"""

import base64
import json
import os
import select
import shutil
import subprocess
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Any, Self

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
QUIET = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-extensions",
    "--disable-dev-shm-usage",
    "--mute-audio",
)
ANSWER_S = 30.0


def program() -> str | None:
    """Return the browser's path, None where there is none."""
    return next((path for name in PROGRAMS if (path := shutil.which(name))), None)


class Chromium:
    """A browser with one page, within a `with` block, in an empty folder of its own.

    Parameters
    ----------
    options
        Further options of the browser.

    Notes
    -----
    Speaks the DevTools protocol over --remote-debugging-pipe: JSON ended by zero bytes, the
    browser's file descriptor 3 to hear and 4 to speak
    (https://chromedevtools.github.io/devtools-protocol/).
    """

    def __init__(self, *options: str) -> None:
        self._options = options
        self._asked, self._buffer = 0, b""
        self._session: str | None = None

    def __enter__(self) -> Self:
        path = program()
        if path is None:
            raise FileNotFoundError("Chromium must be installed (Debian: apt-get install chromium)")
        self._folder = TemporaryDirectory(prefix="charact-chromium-", ignore_cleanup_errors=True)
        heard, self._to = os.pipe()
        self._from, spoken = os.pipe()
        command = [
            path,
            *QUIET,
            *self._options,
            f"--user-data-dir={self._folder.name}",
            "--remote-debugging-pipe",
        ]
        # The shell puts the pipes where the browser expects them.
        placed = ["sh", "-c", f'exec "$@" 3<&{heard} 4>&{spoken}', "sh", *command, "about:blank"]
        self._process = subprocess.Popen(
            placed,
            pass_fds=(heard, spoken),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(heard)
        os.close(spoken)
        targets = self._ask("Target.getTargets")["targetInfos"]
        page = next(target["targetId"] for target in targets if target["type"] == "page")
        self._session = self._ask("Target.attachToTarget", targetId=page, flatten=True)["sessionId"]
        self._ask("Page.enable")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._process.terminate()
        self._process.wait(timeout=ANSWER_S)
        os.close(self._to)
        os.close(self._from)
        self._folder.cleanup()

    def open(self, address: str, *, settle_s: float = 1.0) -> None:
        """Open a page and give it time."""
        self._ask("Page.navigate", url=address)
        time.sleep(settle_s)

    def size(self, width_px: int, height_px: int) -> None:
        """Set the size of the page."""
        self._ask(
            "Emulation.setDeviceMetricsOverride",
            width=width_px,
            height=height_px,
            deviceScaleFactor=1,
            mobile=False,
        )

    def evaluate(self, script: str) -> Any:
        """Return what a script in the page comes to, awaited where it is a promise."""
        answer = self._ask(
            "Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True
        )
        if "exceptionDetails" in answer:
            raise RuntimeError(
                answer["exceptionDetails"]
                .get("exception", {})
                .get("description", "the script failed")
            )
        return answer["result"].get("value")

    def screenshot(self, out: Path) -> None:
        """Write a picture of the page, PNG."""
        out.write_bytes(base64.b64decode(self._ask("Page.captureScreenshot", format="png")["data"]))

    def _ask(self, method: str, **params: Any) -> dict[str, Any]:
        self._asked += 1
        message: dict[str, Any] = {"id": self._asked, "method": method, "params": params}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        until_s = time.monotonic() + ANSWER_S
        while True:
            answer = self._heard(until_s)
            if answer.get("id") == self._asked:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']['message']}")
                return answer["result"]

    def _heard(self, until_s: float) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._from], [], [], max(0.0, until_s - time.monotonic()))
            part = os.read(self._from, 1 << 16) if ready else b""
            if not part:
                raise TimeoutError(f"the browser must answer within {ANSWER_S:g} s, it did not")
            self._buffer += part
        message, _, self._buffer = self._buffer.partition(b"\0")
        return json.loads(message)
