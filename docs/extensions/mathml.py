"""Formulas as MathML, which browsers draw without scripts and without a network."""

import re

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml


def formula(writer, node):
    """Writes a formula within a line."""
    writer.body.append(compact(tex2mathml(node.astext())))
    raise nodes.SkipNode


def display(writer, node):
    """Writes a displayed formula."""
    writer.body.append(compact(tex2mathml(node.astext())).replace("<math", '<math display="block"', 1))
    raise nodes.SkipNode


def compact(markup):
    """Returns the markup without line ends, which browsers would show as spaces."""
    return re.sub(r"\s*\n\s*", "", markup)


def setup(app):
    app.add_html_math_renderer("mathml", (formula, None), (display, None))
    return {"parallel_read_safe": True}
