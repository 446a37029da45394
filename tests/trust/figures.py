"""The figures of long commands on the verification page: one row each, which the command itself writes."""

ENDS = ("<!-- trust -->", "<!-- end of trust -->")
HEAD = ["| what | command | seen | at |", "|---|---|---|---|"]


def with_row(page: str, what: str, command: str, seen: str, at: str) -> str:
    """The page with one row anew; the rows of other commands stay."""
    from torchplate.bench.marked_page import between, put

    rows = [line for line in between(page, ENDS).splitlines()[len(HEAD) :] if not line.startswith(f"| {what} |")]
    rows = sorted([*rows, f"| {what} | `python {command}` | {seen} | {at} |"])
    return put(page, ENDS, "\n".join([*HEAD, *rows]))


def commit() -> str:
    """What is tried; "-dirty" where files differ from it."""
    from torchplate.bench.marked_page import commit

    return commit()


def put(what: str, command: str, seen: str) -> None:
    """Write a row onto docs/verification.md, with the commit that was tried."""
    from torchplate.bench.marked_page import PAGE

    PAGE.write_text(with_row(PAGE.read_text(), what, command, seen, commit()))
