"""A text in the lines and columns of an editor, before one that counts them character by character."""

import random

import pytest
from prosim_scene.language_server import ENCODINGS, Text

PIECES = [
    "",
    "a",
    "é",
    "🎈",
    "\n",
    "\r\n",
    "\r",
    "\f",
    "\v",
    "\x1c",
    "\x85",
    "\u2028",
    "\ufeff",
    "\t",
    "one\ntwo 🎈🎈\n",
]


def grid(text, encoding):
    """The position before each character, and that at the end."""
    codec, size = ENCODINGS[encoding]
    line = column = 0
    for i, character in enumerate(text):
        yield line, column
        column += len(character.encode(codec)) // size
        if character == "\n" or (character == "\r" and text[i + 1 : i + 2] != "\n"):
            line, column = line + 1, 0
    yield line, column


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_changes_have_their_place(encoding):
    choice = random.Random(7)
    text, buffer = "", Text("", encoding)
    for _ in range(300):
        places = list(grid(text, encoding))
        within = [i for i in range(len(text) + 1) if text[i - 1 : i + 1] != "\r\n"]
        assert [buffer.position(i) for i in range(len(text) + 1)] == places
        assert all(buffer.offset(*places[i]) == i for i in within)
        first, last = sorted(choice.choices(within, k=2))
        last = choice.choice([first, last])
        new = "".join(choice.choices(PIECES, k=choice.choice([1, 1, 4])))
        text = text[:first] + new + text[last:]
        buffer = buffer.changed(places[first], places[last], new)
        assert buffer.text == text
        if len(text) > 60:
            text, buffer = "", Text("", encoding)


def test_a_place_that_is_not_there_is_the_end_of_what_is():
    buffer = Text("a 🎈\r\nb")
    assert [buffer.offset(*place) for place in ((0, 3), (0, 4), (0, 9), (1, 9), (2, 0), (9, 9))] == [2, 3, 3, 6, 6, 6]
    buffer = buffer.changed((1, 1), (0, 0), "x")  # an end before the start
    assert buffer.text == "a 🎈\r\nbx"
    assert Text("\ufeffa\rb\r\nc").scene == " a\nb\r\nc"
