"""Settings of the documentation: `make docs` builds it with Sphinx, warnings as errors."""

from pathlib import Path
import re

from saddlering_ros import __version__

project = 'saddlering_ros'
copyright = 'the maintainers, Apache-2.0'
version = release = __version__
extensions = ['myst_parser']
source_suffix = {'.md': 'markdown'}
exclude_patterns = ['_build', '_static']
myst_heading_anchors = 3
myst_enable_extensions = ['colon_fence']
html_theme = 'furo'
html_title = 'saddlering_ros'
html_theme_options = {'navigation_with_keys': True}
html_copy_source = False
pygments_style = 'friendly'


def setup(app: object) -> None:
    """Rewrite pages as they are read."""
    app.connect('source-read', _read)  # type: ignore[attr-defined]
    app.connect('env-get-outdated', lambda *_: ['index'])  # type: ignore[attr-defined]


def _read(_app: object, page: str, source: list[str]) -> None:
    """Name the repository's own files, which are no pages; let the first page list all pages."""
    source[0] = re.sub(r'\[([^\]]*)\]\(\.\./(\w+\.md)[^)]*\)', _named, source[0])
    if page == 'index':
        source[0] += _the_rest(set(source[0].split()))


def _named(link: re.Match[str]) -> str:
    return f'`{link[2]}`' if link[1].strip('`') in link[2] else f'{link[1]} (`{link[2]}`)'


def _the_rest(listed: set[str]) -> str:
    """A last list with the pages that the first page does not name."""
    rest = [file.stem for file in sorted(Path(__file__).resolve().parent.glob('*.md'))
            if file.stem not in listed and file.stem != 'index']
    head = ['', '```{toctree}', ':hidden:', ':caption: More', '']
    return '\n'.join([*head, *rest, '```', '']) if rest else ''
