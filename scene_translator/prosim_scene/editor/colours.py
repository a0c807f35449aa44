"""The words of the language as a TextMate grammar, by which editors colour a scene before any server has read it.

``python -m prosim_scene.editor.colours`` prints it.
"""

import json
import re
from collections.abc import Collection
from typing import Any

from ..language.expressions import CONSTANTS, FUNCTIONS
from ..language.words import ROLES, STATEMENTS, of_role

CONSTANT_ROLES = ("BOOL", "NULL")
NUMBER = r"(?i)(?<![\w.-])[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?(?![\w.-])"


def textmate() -> dict[str, Any]:
    """The grammar as the content of its JSON file."""
    others = [role for role in ROLES if role not in (*STATEMENTS, *CONSTANT_ROLES)]
    values = [{"include": f"#{name}"} for name in ("line", "arithmetic", "variable", "string", "number")]
    return {
        "name": "Scene of the thesis",
        "scopeName": "source.scn",
        "fileTypes": ["scn"],
        "patterns": [
            {
                "begin": rf"(?i)(?<![\w.-])({_words(['STEP'])})\s*[:=]?\s*(\()",
                "beginCaptures": {"1": {"name": "support.type.scn"}},
                "end": r"\)",
                "patterns": values,
            },
            {"include": "#remark"},
            *values,
            {"match": r"(?i)(?<![\w.-])t-[^\s()#\":={}]+", "name": "entity.name.tag.scn"},
            {"match": rf"(?i)(?<![\w.-])({_words(STATEMENTS)})(?![\w.-])", "name": "keyword.control.scn"},
            {"match": rf"(?i)(?<![\w.-])({_words(CONSTANT_ROLES)})(?![\w.-])", "name": "constant.language.scn"},
            {"match": rf"(?i)(?<![\w.-])({_words(others)})(?![\w.-])", "name": "support.type.scn"},
            {"match": r"(?<!\S)[-+*](?!\S)", "name": "keyword.operator.scn"},
        ],
        "repository": {
            "remark": {"begin": r"\(", "end": r"\)", "name": "comment.block.scn", "patterns": [{"include": "#remark"}]},
            "line": {"match": r"#.*$", "name": "comment.line.number-sign.scn"},
            "string": {"match": r'"[^"\n]*"', "name": "string.quoted.double.scn"},
            "number": {"match": NUMBER, "name": "constant.numeric.scn"},
            "variable": {"match": r"\$[A-Za-z_]\w*", "name": "variable.other.scn"},
            "arithmetic": {
                "begin": r"\{",
                "end": r"\}|$",
                "name": "meta.embedded.arithmetic.scn",
                "patterns": [
                    {"include": "#variable"},
                    {"match": r"(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", "name": "constant.numeric.scn"},
                    {"match": rf"\b({'|'.join([*FUNCTIONS, *CONSTANTS])})\b", "name": "support.function.scn"},
                    {"match": r"[-+*/^]", "name": "keyword.operator.scn"},
                ],
            },
        },
    }


def _words(roles: Collection[str]) -> str:
    spellings = {spelling for role in roles for word in of_role(role) for spelling in word.spellings}
    return "|".join(sorted(map(re.escape, spellings), key=lambda word: (-len(word), word)))


if __name__ == "__main__":
    print(json.dumps(textmate(), indent=2))
