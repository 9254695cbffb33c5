"""Formulas as MathML, which browsers draw by themselves: neither LaTeX nor a script from elsewhere is needed."""

from typing import Any

from docutils import nodes
from docutils.utils.math import latex2mathml


def mathml(formula: str, *, block: bool) -> str:
    """Return a formula in LaTeX as MathML.

    Raises:
        docutils.utils.math.MathError: If it cannot be translated.
    """
    tree = latex2mathml.tex2mathml(formula, as_block=block)
    return str(tree)


def _visit_inline(self: Any, node: nodes.math) -> None:
    self.body.append(mathml(node.astext(), block=False))
    raise nodes.SkipNode


def _visit_block(self: Any, node: nodes.math_block) -> None:
    self.body.append(f'<div class="math">{mathml(node.astext(), block=True)}</div>')
    raise nodes.SkipNode


def setup(app: Any) -> dict[str, bool]:
    """Register with Sphinx."""
    app.add_html_math_renderer("mathml", (_visit_inline, None), (_visit_block, None))
    app.config.html_math_renderer = "mathml"
    return {"parallel_read_safe": True}
