"""Settings of the documentation's site: ``python -m sphinx -W -b html docs docs/_build``."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "extensions"))

project = "mitsuba-prosim"
author = "the authors of mitsuba-prosim"
copyright = f"2026, {author}"
html_title = project
html_theme = "furo"
html_static_path = ["style"]
html_css_files = ["plugins.css"]
html_favicon = "style/favicon.svg"  # four samples in an N-rook pattern
html_math_renderer = "mathml"
highlight_language = "none"
extensions = ["myst_nb", "sphinx_tabs.tabs", "mathml", "notebook_pages", "plugin_pages", "scene_lexer"]
exclude_patterns = ["_build", "jupyter_execute"]
nitpicky = True
myst_heading_anchors = 3
myst_enable_extensions = ["dollarmath"]
nb_execution_mode = "off"  # notebook_pages runs them

# The words that Mitsuba's own plugin documentation uses, and so ours.
rst_prolog = r"""
.. role:: paramtype
.. role:: monosp

.. |bool| replace:: :paramtype:`boolean`
.. |int| replace:: :paramtype:`integer`
.. |integer| replace:: :paramtype:`integer`
.. |float| replace:: :paramtype:`float`
.. |string| replace:: :paramtype:`string`
.. |point| replace:: :paramtype:`point`
.. |vector| replace:: :paramtype:`vector`
.. |transform| replace:: :paramtype:`transform`
.. |spectrum| replace:: :paramtype:`spectrum`
.. |texture| replace:: :paramtype:`texture`
.. |true| replace:: :monosp:`true`
.. |false| replace:: :monosp:`false`
.. |exposed| replace:: :abbr:`P (mi.traverse shows it)`
.. |differentiable| replace:: :abbr:`∂ (has derivatives)`
.. |discontinuous| replace:: :abbr:`D (moves an edge, whose share of the derivative is left out)`
"""
