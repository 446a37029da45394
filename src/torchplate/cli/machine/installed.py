"""What is installed, by name and version."""

from importlib.metadata import PackageNotFoundError, version


def version_of(package: str) -> str:
    """The version of a package, or that it is not installed: one that runs from its source, by PYTHONPATH, is not."""
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
