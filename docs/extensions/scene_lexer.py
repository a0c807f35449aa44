"""Colours for the scene language, in blocks marked ``scn``."""

from typing import ClassVar

from prosim_scene.language.words import WORDS
from pygments.lexer import RegexLexer, bygroups
from pygments.token import Comment, Keyword, Name, Number, Operator, Punctuation, String, Text

STEPS = "|".join(spelling for row in WORDS if row.role == "STEP" for spelling in row.spellings)
KEYWORDS = "|".join(sorted({spelling for row in WORDS for spelling in row.spellings}, key=len, reverse=True))


class SceneLexer(RegexLexer):
    """Highlights words of the language, numbers, names, quoted file names and comments."""

    name = "scn"
    tokens: ClassVar[dict] = {
        "root": [
            (rf"(?i)((?:{STEPS})\s*)(\()", bygroups(Keyword, Text)),
            (r"#.*", Comment),
            (r"\(", Comment, "comment"),
            (r'"[^"\n]*"', String),
            (r"\$\w+", Name.Variable),
            (r"\{", Punctuation, "arithmetic"),
            (r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?(?![\w-])", Number),
            (rf"(?i)(?:{KEYWORDS})(?![\w.-])", Keyword),
            (r"[\w.-]+", Name),
            (r"\s+|.", Text),
        ],
        "arithmetic": [
            (r"\}|\n", Punctuation, "#pop"),
            (r"\$\w+", Name.Variable),
            (r"(\d+\.?\d*|\.\d+)(e[+-]?\d+)?", Number),
            (r"\w+", Name.Function),
            (r"\s+|.", Operator),
        ],
        "comment": [(r"\(", Comment, "#push"), (r"\)", Comment, "#pop"), (r"[^()]+", Comment)],
    }


def setup(app):
    app.add_lexer("scn", SceneLexer)
    return {"parallel_read_safe": True}
