"""What mkdocs calls while it builds: adds the generated pages and the figures, and points links at them."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mkdocs.structure.files import File, Files
from pages import PAGES, ROOT

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig

FIGURES = "runs/*/*.png"


def on_files(files: Files, config: "MkDocsConfig") -> Files:
    """Add what is made from the code, and the figures that lie outside of docs."""
    for name, page in PAGES.items():
        files.append(File.generated(config, name, content=page()))
    for path in sorted(ROOT.glob(FIGURES)):
        files.append(File.generated(config, path.relative_to(ROOT).as_posix(), abs_src_path=str(path)))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """A figure is one folder up on the page as it lies in the project, and beside it on the site."""
    up = "../" * (len(Path(page.file.src_uri).parts) - 1)
    return re.sub(r"\]\((?:\.\./)+runs/", f"]({up}runs/", markdown)
