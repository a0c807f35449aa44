"""Colours for the scene language, in blocks marked ``scn``."""

from typing import ClassVar

from pygments.lexer import RegexLexer, bygroups
from pygments.token import Comment, Keyword, Name, Number, String, Text


class SceneLexer(RegexLexer):
    """Words that begin a statement, numbers, file names in quotes, and remarks."""

    name = "scn"
    tokens: ClassVar = {
        "root": [
            (r"(?i)((?:scale|translate|rotate-[xyz])\s*)(\()", bygroups(Keyword, Text)),
            (r"#.*", Comment),
            (r"\(", Comment, "remark"),
            (r'"[^"\n]*"', String),
            (r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?(?![\w-])", Number),
            (r"[A-Z][A-Z-]+(?![\w-])", Keyword),
            (r"[\w.-]+", Name),
            (r"\s+|.", Text),
        ],
        "remark": [(r"\(", Comment, "#push"), (r"\)", Comment, "#pop"), (r"[^()]+", Comment)],
    }


def setup(app):
    app.add_lexer("scn", SceneLexer)
    return {"parallel_read_safe": True}
