"""A headless Chromium to look at reports with; as a command, it takes pictures of one.

    python tests/report/browser.py runs/hidden_effect/diagnosis/report.html docs/pictures/diagnosis

writes `diagnosis_360.png` and `diagnosis_1440.png`. The browser is spoken to over two pipes, in the messages of its
DevTools protocol: no driver, no port.
"""

import base64
import fcntl
import io
import json
import os
import select
import shutil
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from PIL import Image

NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome", "chrome")
PATIENCE = 30.0
"""Seconds for one answer: a browser that has to be read from disk takes some."""
BEYOND_OURS = 20
"""Descriptors from here on are nobody's: the browser's are moved there before they become its 3 and 4."""


def found() -> str | None:
    """The path of a Chromium on this machine."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


class Browser:
    """One page in one browser, closed with it.

    Args:
        path: of the browser.
    """

    def __init__(self, path: str) -> None:
        self._profile = tempfile.mkdtemp(prefix="report-browser-")
        command = [path, "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars"]
        command += ["--remote-debugging-pipe", "--no-first-run", f"--user-data-dir={self._profile}", "about:blank"]
        theirs_in, ours_out = os.pipe()
        ours_in, theirs_out = os.pipe()
        moved = [fcntl.fcntl(one, fcntl.F_DUPFD, BEYOND_OURS) for one in (theirs_in, theirs_out)]
        quiet = os.open(os.devnull, os.O_WRONLY)
        taken = {moved[0]: 3, moved[1]: 4}
        actions = [(os.POSIX_SPAWN_DUP2, one, number) for one, number in taken.items()]
        actions += [(os.POSIX_SPAWN_DUP2, quiet, number) for number in (1, 2)]
        self._process = os.posix_spawn(path, command, os.environ, file_actions=actions, setpgroup=0)
        for one in (theirs_in, theirs_out, *moved, quiet):
            os.close(one)
        self._out, self._in, self._left, self._turn = ours_out, ours_in, b"", 0
        self._session: str | None = None
        self._events: list[dict[str, Any]] = []
        try:
            (target,) = [one for one in self.ask("Target.getTargets")["targetInfos"] if one["type"] == "page"][:1]
            self._session = self.ask("Target.attachToTarget", targetId=target["targetId"], flatten=True)["sessionId"]
            self.ask("Page.enable")
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> "Browser":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the browser and take its files away."""
        for one in (self._out, self._in):
            os.close(one)
        os.killpg(self._process, signal.SIGKILL)
        os.waitpid(self._process, 0)
        for _ in range(20):
            shutil.rmtree(self._profile, ignore_errors=True)
            if not Path(self._profile).exists():
                break
            time.sleep(0.05)

    def ask(self, method: str, **params: Any) -> dict[str, Any]:
        """One message, and its answer.

        Raises:
            RuntimeError: if the browser refuses it.
        """
        self._turn += 1
        message = {"id": self._turn, "method": method, "params": params}
        if self._session is not None:
            message["sessionId"] = self._session
        os.write(self._out, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._read()
            if answer.get("id") == self._turn:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']}")
                return dict(answer["result"])
            self._events.append(answer)

    def _read(self) -> dict[str, Any]:
        end = time.monotonic() + PATIENCE
        while b"\0" not in self._left:
            if not select.select([self._in], [], [], max(0.0, end - time.monotonic()))[0]:
                raise TimeoutError(f"The browser has said nothing for {PATIENCE:g} s.")
            part = os.read(self._in, 1 << 16)
            if not part:
                raise RuntimeError("The browser has ended.")
            self._left += part
        message, _, self._left = self._left.partition(b"\0")
        return dict(json.loads(message))

    def open(self, path: Path) -> None:
        """Show a file, and wait until it is loaded."""
        self.visit(path.resolve().as_uri())

    def visit(self, address: str) -> None:
        """Show a page, and wait until it is loaded."""
        self._events.clear()
        self.ask("Page.navigate", url=address)
        while not any(event.get("method") == "Page.loadEventFired" for event in self._events):
            self._events.append(self._read())

    def look(self, width: int, scheme: str = "light", medium: str = "screen", height: int = 900) -> None:
        """Take on a screen of this width [px], a colour scheme and a medium."""
        self.ask(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600
        )
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        self.ask("Emulation.setEmulatedMedia", media=medium, features=features)

    def value(self, script: str) -> Any:
        """What a script in the page comes to."""
        found = self.ask("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in found:
            raise RuntimeError(str(found["exceptionDetails"]))
        return found["result"].get("value")

    def picture(self, height: int | None = None) -> bytes:
        """A PNG of the page from its top, all of it or so many pixels."""
        size = self.ask("Page.getLayoutMetrics")["cssContentSize"]
        clip = {"x": 0, "y": 0, "width": size["width"], "height": min(size["height"], height or 10**9), "scale": 1}
        data = self.ask("Page.captureScreenshot", format="png", clip=clip, captureBeyondViewport=True)["data"]
        return base64.b64decode(data)


def main(arguments: list[str]) -> int:
    """Take pictures of a report for the documentation, on a telephone and on a wide screen."""
    path = found()
    if path is None or len(arguments) != 2:
        print("Expected Chromium on this machine, a report.html and a name for its pictures.", file=sys.stderr)
        return 2
    report, name = Path(arguments[0]), Path(arguments[1])
    name.parent.mkdir(parents=True, exist_ok=True)
    with Browser(path) as browser:
        for width, height in ((360, 2400), (1440, 2400)):
            browser.look(width)
            browser.open(report)
            with Image.open(io.BytesIO(browser.picture(height))) as image:
                image.convert("RGB").quantize(64).save(name.with_name(f"{name.name}_{width}.png"), optimize=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
