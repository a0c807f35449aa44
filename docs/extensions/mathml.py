"""Formulas as MathML, which browsers draw by themselves: the site needs neither scripts nor a network for them."""

import re

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml


def formula(writer, node):
    """A formula within a line."""
    writer.body.append(compact(tex2mathml(node.astext())))
    raise nodes.SkipNode


def display(writer, node):
    """A formula in lines of its own."""
    writer.body.append(compact(tex2mathml(node.astext())).replace("<math", '<math display="block"', 1))
    raise nodes.SkipNode


def compact(markup):
    """Without the line ends, of which browsers would make spaces."""
    return re.sub(r"\s*\n\s*", "", markup)


def setup(app):
    app.add_html_math_renderer("mathml", (formula, None), (display, None))
    return {"parallel_read_safe": True}
