"""The site builds without a warning, and loads nothing from another host."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    pytest.importorskip("material", reason="mkdocs-material is not here; `make docs` installs it")
    folder = tmp_path_factory.mktemp("site")
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(folder)],
        cwd=ROOT,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "WARNING" not in done.stderr
    return folder


@pytest.mark.check
def test_every_page_is_there_and_loads_nothing_from_elsewhere(site):
    pages = sorted(site.rglob("*.html"))
    sources = {path.relative_to(ROOT / "docs").with_suffix(".html") for path in (ROOT / "docs").rglob("*.md")}
    assert sources <= {page.relative_to(site) for page in pages}
    for page in pages:
        text = page.read_text()
        loaded = re.findall(r"<(?:link|script|img|iframe)\b[^>]*?\b(?:src|href)=\"?([^\s\">]+)", text)
        assert not [where for where in loaded if re.match(r"(?:https?:)?//", where)], page
    assert "url(http" not in (site / "style.css").read_text()


@pytest.mark.check
def test_every_picture_and_every_place_that_a_page_points_at_is_there(site):
    for page in site.rglob("*.html"):
        if page.name == "404.html":
            continue
        for where in re.findall(r"<(?:img|a)\b[^>]*?\b(?:src|href)=\"?([^\s\">]+)", page.read_text()):
            file, _, anchor = where.partition("#")
            if re.match(r"\w+:", where):
                continue
            target = (page.parent / file).resolve() if file else page
            assert target.exists(), f"{page.name}: {where}"
            if anchor and target.suffix == ".html":
                assert re.search(rf'id="?{re.escape(anchor)}[">\s]', target.read_text()), f"{page.name}: {where}"
