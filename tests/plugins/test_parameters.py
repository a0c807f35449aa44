"""What plugins accept as a number, a whole number or a word, and what they say of anything else."""

import math

import mitsuba as mi
import pytest
from mitsuba_prosim.parameters import choice, number, reject, whole


def properties(**values):
    props = mi.Properties("prosim_thing")
    for name, value in values.items():
        props[name] = value
    return props


def test_whole_numbers_may_be_written_as_floats_and_all_have_defaults(variant_rgb):
    for value in (10, 10.0):
        found = whole(properties(n=value), "n", 5, 1)
        assert found == 10 and type(found) is int
    assert whole(properties(), "n", 5, 1) == 5
    assert number(properties(), "x", 0.5, 0) == 0.5
    assert choice(properties(), "word", ("first", "second")) == "first"


@pytest.mark.parametrize("value", (2.7, 0, -1, 9, math.nan, math.inf, True, "three"))
def test_numbers_out_of_range_are_rejected(variant_rgb, value):
    with pytest.raises(ValueError, match=r'prosim_thing: parameter "n" is .*; allowed: a whole number >= 1 and <= 8\.'):
        whole(properties(n=value), "n", 5, 1, 8)
    if value != 2.7:
        with pytest.raises(ValueError, match=r'"n" is .*; allowed: a number > 0 and <= 8\.'):
            number(properties(n=value), "n", 1.0, 0, 8, open_below=True)


def test_what_is_missing_infinite_or_another_word_is_rejected(variant_rgb):
    assert number(properties(x=-7), "x", 1.0, -math.inf) == -7.0
    with pytest.raises(ValueError, match=r"allowed: a number\."):
        number(properties(x=math.inf), "x", 1.0, -math.inf)
    for read in (number, whole):
        with pytest.raises(ValueError, match='parameter "x" is missing; allowed: '):
            read(properties(), "x", None, 0)
    with pytest.raises(ValueError, match="is 'third'; allowed: first or second"):
        choice(properties(word="third"), "word", ("first", "second"))
    with pytest.raises(ValueError, match="is 4; allowed: one of a, b, c"):
        choice(properties(word=4), "word", ("a", "b", "c"))


def test_errors_name_the_plugin_and_its_id(variant_rgb):
    props = properties()
    props.set_id("lamp")
    assert str(reject(props, "x", None, "a")) == '"lamp" (prosim_thing): parameter "x" is missing; allowed: a.'
