"""What is written as other languages write it -> what to say of that: brackets, blocks, remarks and directives."""

import re

from .definitions import NUMBER

BRACES = "braces hold arithmetic, as in {360 * $frame / 48}"
NO_BLOCKS = f"{BRACES}, and blocks need none: a statement goes on up to the next one"
SPACED = "expected numbers with nothing but spaces between them"
ENDLESS = "a statement ends where the next one begins, without a mark"
REMARK = "expected a remark to begin with #, or to stand in parentheses"
#: Numbers between commas, or between spaces. Where both are there, a comma may be a point, as in 0,5 0,5.
ONE = NUMBER.pattern
NUMBERS = re.compile(rf"\s*{ONE}(?:(?:\s*,\s*{ONE})+|(?:\s+{ONE})+)\s*", re.IGNORECASE)
#: What opens a vector elsewhere, and what stands in it.
BRACKETS = re.compile(r"[<\[]([^<>\[\]\n]*)(?:[>\]]|$)", re.MULTILINE)
#: A tag of XML.
TAG = re.compile(r"<[\w?!/]*[^\W\d]|<[?!/]")
#: What begins a block: nothing up to the line's end, or a word and what cannot follow it in arithmetic.
BLOCK = re.compile(r"(?:\s|[-+*]\s)*(?:$|<|[^\W\d][\w-]*(?:\s+[\w.<\"]|\s*=|\s*$))")
#: What may follow the last mark of a line.
REST_OF_LINE = re.compile(r"[^\S\n]*(?:$|#|//)", re.MULTILINE)
#: Remarks that do something in other languages: their word, and the name and the value that some of them give.
DIRECTIVE = re.compile(
    r"#\s*(?:(?P<gives>declare|local)\s+(?P<name>\w+)\s*=\s*(?P<value>[^;\n]*)"
    r"|(?P<defines>define)\s+(?P<macro>\w+)\s+(?P<text>[-+.\d\"(][^\n]*)"
    r"|(?P<includes>include)\s*[\"<]|(?P<makes>macro)\s+\w+\s*\()"
    r"|#(?:(?P<loops>while|for)\s*\(|(?P<chooses>if|ifdef|ifndef|elseif|switch)\s*\(|(?P<versions>version)\s+[\d.])"
)
#: What the language lacks, by the group of a directive that would be for it.
LACKS = {
    "includes": "a scene is one file",
    "makes": "the language has no macros",
    "loops": "the language has no loops, and what repeats is written out",
    "chooses": "the language has no conditions",
    "versions": "the language has no versions",
}


def spaced(text: str) -> str | None:
    """Two numbers or more between commas or spaces, as this language writes them; None for all else."""
    return " ".join(re.split(r"\s*,\s*|\s+", text.strip())) if NUMBERS.fullmatch(text) else None


def word(text: str, start: int, found: str) -> str | None:
    """What to say of a word that has no place where it stands, which is at ``start`` of a text; None of most."""
    if TAG.match(text, start):
        return "that is no scene in this language; expected a name that ends in .xml of a file in Mitsuba's"
    if text.startswith("--", start) or "//" in found or "/*" in found or found[0] in "%!":
        return REMARK
    if found[-1] == ";" and REST_OF_LINE.match(text, start + len(found)):
        return ENDLESS
    if found[0] in "<[":
        inside = BRACKETS.match(text, start)
        numbers = spaced(inside[1]) if inside else None
        return f"{SPACED}, and no brackets" + (f": {numbers}" if numbers else ", as in 1 2 3")
    return NO_BLOCKS if found[0] in "{}" else None


def braces(inside: str) -> str | None:
    """What to say of what stands in braces and is no arithmetic; None where it is most likely meant as such."""
    numbers = spaced(inside)
    if numbers and numbers.count(" ") > 1:  # two may be a fraction, as 0,5, or lack an operator
        return f"{BRACES}; {SPACED}, and no braces: {numbers}"
    return NO_BLOCKS if BLOCK.match(inside) else None


def remark(text: str) -> str | None:
    """What to say of a remark that would do something in another language; None of most."""
    found = DIRECTIVE.match(text)
    if found is None:
        return None
    begin = "this line is a remark, as all that begins with # is"
    for group, lack in LACKS.items():
        if found[group]:
            return f"{begin}; {lack}"
    name, value = (found["name"], found["value"]) if found["gives"] else (found["macro"], found["text"])
    return f"{begin}; a name gets its value by DEFAULT ${name} = {value.strip()[:60]}, and is written ${name}"
