"""What a channel's name says, told where the first one stands."""

import re
from collections.abc import Iterator, Sequence

from torchplate.measurement import Channel, Measurement
from torchplate.report.blocks.document import Block, Paragraph, words


def explained(blocks: Sequence[Block], measurement: Measurement) -> Iterator[Block]:
    """The same blocks, with what channel names say before the first that holds one.

    Args:
        blocks: of a report.
        measurement: whose channels they name.
    """
    names = {end.label for end in (*measurement.response, *measurement.reference)}
    pattern = re.compile(rf"(?<![\w.])(?:{'|'.join(map(re.escape, sorted(names, key=len, reverse=True)))})(?!\w|\.\d)")
    told = False
    for block in blocks:
        if not told and any(pattern.search(text) for text in words(block)):
            told = True
            yield Paragraph(sentence(measurement))
        yield block


def sentence(measurement: Measurement) -> str:
    """What the names of these channels say, on the first of them."""
    j, k = measurement.pairs[0]
    response, reference = measurement.response[j], measurement.reference[k]
    first = (
        f"A channel is named by its node and direction: `{response.label}` is the deflection w, out of the plate, at "
    )
    first += f"node {response.node} of the test sheet" if response.node else "a place without a node number"
    over = (
        "the motion of the held edges" if measurement.kind == "transmissibility" else f"the force at {_at(reference)}"
    )
    return f"{first}; `{measurement.pair_label(j, k)}` is the response at {_at(response)} over {over}."


def _at(channel: Channel) -> str:
    return f"node {channel.node}" if channel.node else "its place"
