"""The reader of XML finds the names that Mitsuba's parser does."""

import random

import mitsuba as mi
from mitsuba_prosim.scene.references import UnreadableError, references

#: What values of attributes are made of, and what stands between elements.
WITHIN = [
    "&#x2e;",
    "&#47;",
    "&#13;",
    "&#10;",
    "&#x85;",
    "&amp;",
    "&amp;#47;",
    "&quot;",
    "'",
    "-->",
    "\r",
    "\n",
    "\t",
    "\r\n",
]
WITHIN += ["$a", "$ab", "$ac", "$b", "$", "\\", "a", "b", "..", "/", " ", ">", "é", "\u2028", "🎈", "<", "&", "&x;"]
BETWEEN = ["<!-- {} -->", "<![CDATA[ {} ]]>", "<?p {} ?>", "<!--{}--->", "]]>", "\r\n", "<![CDATA[ <!-- ]]>", "&lt;"]
HIDDEN = '<spectrum name="y" filename="hidden"/>'


def test_it_finds_the_names_that_mitsubas_parser_does(variant_rgb, tmp_path):
    """Wherever both take a text; random ones, of what is read otherwise where one is careless."""
    rng, path = random.Random(1), tmp_path / "scene.xml"
    found = refused = 0
    config = mi.parser.ParserConfig("scalar_rgb")
    config.unused_parameters = mi.LogLevel.Trace
    for _ in range(300):
        values = ["".join(rng.choices(WITHIN, k=rng.randrange(6))) for _ in range(4)]
        before, after = ("".join(rng.choices(BETWEEN, k=rng.randrange(2))).replace("{}", HIDDEN) for _ in "ab")
        defaults = "".join(
            f'<default name="{n}" value="{v}"/>' for n, v in zip(("a", "ab", "ac"), values, strict=False)
        )
        text = f'<scene version="3.0.0">{defaults}{before}<shape type="ply">{{}}</shape>{after}</scene>'
        path.write_bytes(text.format(f'<spectrum name="x" filename="{values[3]}"/>').encode())
        try:
            ours = [element.name for element in references(path, {"b": "$ab"}, mi.file_resolver())]
        except UnreadableError:
            refused += 1
            continue
        path.write_bytes(text.format(f'<string name="x" value="{values[3]}"/>').encode())
        try:
            state = mi.parser.parse_file(config, str(path), b="$ab")
        except RuntimeError:  # a parameter without a value
            refused += 1
            continue
        theirs = [value for node in state.nodes for _, value in node.props.items() if isinstance(value, str)]
        assert ours == [value for value in theirs if value], text
        found += "$" in values[3] and bool(ours)
    assert found > 10 and refused > 10
