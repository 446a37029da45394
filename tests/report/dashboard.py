"""Takes pictures of TensorBoard's pages for the documentation, with the browser of `browser.py`.

    python tests/report/dashboard.py runs/paper docs/pictures/tensorboard

writes `tensorboard_custom_scalars.png`, which the documentation shows of two searches of `configs/steel_plate.yaml`
with five seeds each, and `tensorboard_hparams.png`. On a machine that is busy give more seconds for
each page to be drawn: --wait 120.
"""

import argparse
import io
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from PIL import Image

# It is run as a script, beside which its neighbour lies.
sys.path.insert(0, str(Path(__file__).parent))
import browser

PAGES = {"custom_scalars": 1150, "hparams": 640}
"""By the page's own name, the height of its picture [px]."""
WIDTH = 1440


@contextmanager
def served(folder: Path, patience: float) -> Iterator[str]:
    """TensorBoard over a folder on a free port of this machine; its address."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    command = [sys.executable, "-m", "tensorboard.main", "--logdir", str(folder), "--host", "127.0.0.1"]
    command += ["--port", str(port), "--load_fast", "false"]
    server = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    address, end = f"http://127.0.0.1:{port}", time.monotonic() + patience
    try:
        while True:
            try:
                with urllib.request.urlopen(f"{address}/data/runs", timeout=patience) as answer:
                    if answer.read().strip() not in (b"[]", b""):
                        break
            except OSError:
                if time.monotonic() > end:
                    raise
            time.sleep(1.0)
        yield address
    finally:
        server.terminate()
        server.wait()


def main() -> int:
    """Take the pictures; returns the exit status."""
    parser = argparse.ArgumentParser(description="Take pictures of TensorBoard's pages.")
    parser.add_argument("folder", type=Path, help="of runs")
    parser.add_argument("name", type=Path, help="that the pictures' names begin with")
    parser.add_argument("--wait", type=float, default=15.0, help="seconds for each page to be drawn")
    given = parser.parse_args()
    path = browser.found()
    if path is None:
        print("Expected Chromium on this machine, found none. Install it.", file=sys.stderr)
        return 2
    browser.PATIENCE = max(browser.PATIENCE, 10 * given.wait)
    given.name.parent.mkdir(parents=True, exist_ok=True)
    with served(given.folder, 20 * given.wait) as address:
        for page, height in PAGES.items():
            # A browser each: what follows # alone does not load a page anew.
            with browser.Browser(path) as one:
                one.look(WIDTH, height=height)
                one.visit(f"{address}/#{page}")
                time.sleep(given.wait)
                with Image.open(io.BytesIO(one.picture(height))) as image:
                    small = image.convert("RGB").quantize(64)
                    small.save(given.name.with_name(f"{given.name.name}_{page}.png"), optimize=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
