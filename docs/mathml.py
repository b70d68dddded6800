"""Equations as MathML, which every browser draws by itself: the built pages need no network and no script."""

from docutils import nodes
from latex2mathml.converter import convert


def inline(writer, node):
    writer.body.append(convert(node.astext()))
    raise nodes.SkipNode


def block(writer, node):
    source = node.astext().strip()
    rows = r"\\" in source and r"\begin" not in source
    source = rf"\begin{{aligned}}{source}\end{{aligned}}" if rows else source
    writer.body.append(f'<div class="math" style="overflow-y: hidden">{convert(source, display="block")}</div>')
    raise nodes.SkipNode


def setup(app):
    app.add_html_math_renderer("mathml", (inline, None), (block, None))
    return dict(parallel_read_safe=True, parallel_write_safe=True)
