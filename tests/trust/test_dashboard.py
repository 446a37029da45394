"""What comes from a config or from a head of a file is text in TensorBoard, too: in a browser, page by page."""

import importlib.util
import sys
import time
from pathlib import Path

import pytest

from torchplate.measurement import Measurement, write_uff

_REPORT = Path(__file__).parents[1] / "report"
sys.path.insert(0, str(_REPORT))
_SPEC = importlib.util.spec_from_file_location("torchplate_dashboard", _REPORT / "dashboard.py")
assert _SPEC is not None
assert _SPEC.loader is not None
dashboard = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(dashboard)
browser = dashboard.browser

pytestmark = [
    pytest.mark.check,
    pytest.mark.skipif(browser.found() is None, reason="this machine has no Chromium"),
]
# No folder can have a slash in its name.
HOSTILE = "<img src=x onerror='window.owned=1'><script>window.owned=1<script>"
# The pages are made of components whose insides `document.querySelectorAll` does not see.
INSIDE = """
(() => {
  const found = [], text = [];
  const into = root => {
    for (const one of root.querySelectorAll('*')) {
      if (one.matches("img[src='x'], [onerror]")) found.push(one.outerHTML);
      for (const part of one.childNodes)
        if (part.nodeType === 3 && !['SCRIPT', 'STYLE'].includes(one.tagName)) text.push(part.textContent);
      if (one.shadowRoot) into(one.shadowRoot);
    }
  };
  into(document);
  return JSON.stringify([window.owned === undefined, found.length, text.join(' ').includes("<img src=x onerror=")]);
})()
"""


def test_a_header_and_a_label_with_a_script_are_text_in_tensorboard(bench, make_config, command):
    frfs = Measurement.from_npz(bench.folder / "plate.npz")
    write_uff(frfs, bench.folder / "plate.uff")
    lines = (bench.folder / "plate.uff").read_text().splitlines()
    for start in [at for at, line in enumerate(lines) if line.split() == ["58"]]:
        lines[start + 1 : start + 6] = [HOSTILE] * 5
    (bench.folder / "plate.uff").write_text("\n".join(lines) + "\n")
    content = make_config(["plate.youngs_modulus"], {"measurement.file": "plate.uff", "search.n_generation": 3})
    content["effects"][f"wires{HOSTILE}"] = content["effects"].pop("wires")
    content["effects"][f"wires{HOSTILE}"]["stiffness"] = [700.0, 2000.0]
    path = bench.write(content, f"plate {HOSTILE}.yaml")
    folder = bench.folder / "logs" / f"run {HOSTILE}"
    assert command("run", path, "--out", folder)[0] == 0
    with dashboard.served(bench.folder / "logs", 60.0) as address:
        for page in ("timeseries", "custom_scalars", "hparams", "images"):
            with browser.Browser(browser.found()) as one:
                one.look(1440)
                one.visit(f"{address}/#{page}")
                end, seen = time.monotonic() + 30.0, "[true, 0, false]"
                while time.monotonic() < end and seen.endswith("false]"):
                    time.sleep(1.0)
                    seen = one.value(INSIDE)
            # It has run nothing, made nothing, and is there to be read.
            assert seen == "[true,0,true]", page
