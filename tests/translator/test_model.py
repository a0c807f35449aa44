import html
from pathlib import Path

import prosim_scene

PALITO = Path(__file__).parents[2] / "examples/palito.scn"


def test_a_scene_shows_itself_in_its_own_language():
    scene = prosim_scene.parse(PALITO.read_text(encoding="utf-8"), PALITO)
    shown = scene._repr_html_()
    text = html.unescape(shown.removeprefix("<pre>").removesuffix("</pre>"))
    assert shown.startswith("<pre>NAME: palito") and prosim_scene.parse(text, "shown") == scene
