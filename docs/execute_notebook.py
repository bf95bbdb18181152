"""Execute the notebook of examples/ and keep what it shows: python docs/execute_notebook.py."""

from __future__ import annotations

import ast
import base64
import contextlib
import io
import json
import os
from pathlib import Path
import tempfile
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOK = ROOT / 'examples' / 'from_bags_to_a_verdict.ipynb'
FORMS = {'_repr_html_': 'text/html', '_repr_png_': 'image/png'}


def shown(source: str, names: dict[str, Any]) -> tuple[str, Any] | None:
    """Execute a cell; form and content that a notebook shows of its last expression."""
    tree = ast.parse(source)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, '<cell>', 'exec'), names)
    value = None if last is None else eval(
        compile(ast.Expression(last.value), '<cell>', 'eval'), names)
    for form, kind in FORMS.items():
        if hasattr(value, form):
            return kind, getattr(value, form)()
    return None


def executed(notebook: dict[str, Any]) -> dict[str, Any]:
    """The notebook with the outputs of its cells; the current folder holds `bags`."""
    names: dict[str, Any] = {}
    codes = [cell for cell in notebook['cells'] if cell['cell_type'] == 'code']
    for count, cell in enumerate(codes, start=1):
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            seen = shown(''.join(cell['source']), names)
        cell |= {'execution_count': count, 'outputs': [
            *_stream(printed.getvalue()), *([] if seen is None else [_data(*seen, count)])]}
    return notebook


def _stream(text: str) -> list[dict[str, Any]]:
    """Printed text; of a line that was written over, its last state."""
    lines = [line.rpartition('\r')[2] for line in io.StringIO(text)]
    return [{'output_type': 'stream', 'name': 'stdout', 'text': lines}] if lines else []


def _data(kind: str, content: Any, count: int) -> dict[str, Any]:
    data = base64.b64encode(content).decode() if isinstance(content, bytes) else (
        content.splitlines(keepends=True))
    return {'output_type': 'execute_result', 'execution_count': count, 'metadata': {},
            'data': {kind: data}}


def main() -> None:
    """Execute on the shipped bags, in a folder that is thrown away."""
    notebook = json.loads(NOTEBOOK.read_text(encoding='utf-8'))
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / 'bags').symlink_to(ROOT / 'bags')
        os.chdir(folder)
        executed(notebook)
        os.chdir(ROOT)
    NOTEBOOK.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + '\n',
                        encoding='utf-8')


if __name__ == '__main__':
    main()
