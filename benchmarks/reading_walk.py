"""Stops and returns of a reader who follows the runs through the engine, from the code alone.

python benchmarks/reading_walk.py PACKAGE MODULE:FUNCTION TYPE [--show]

The reader begins at FUNCTION and reads each function of the engine at its first call, in the
order of the code, if it takes the runs: a parameter or the object of the method is of TYPE, or of
a class with a field that holds TYPE. After each function the reader returns to the caller. A stop
is a stay in one file; a return is a stop in a file that was left before. PACKAGE may be an older
checkout.

    python benchmarks/reading_walk.py saddlering_ros discrepancy.engine:diagnose_system RunBlocks
"""

from __future__ import annotations

import argparse
import ast
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
import re

ENGINE = 'discrepancy'
RETURN = '...'


Known = tuple[str, ast.AST | None]
"""A module and the definition of a name in it; None for the module itself."""


@dataclass(frozen=True)
class Place:
    """A function in its module; owner: the class of a method, or None."""

    module: str
    function: ast.FunctionDef
    owner: ast.ClassDef | None = None

    @property
    def key(self) -> tuple[str, str, str]:
        return self.module, self.owner.name if self.owner else '', self.function.name


class Package:
    """The syntax trees of a package, and the definitions of its names."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.trees: dict[str, ast.Module] = {}
        self.paths: dict[str, Path] = {}
        for path in sorted(root.rglob('*.py')):
            parts = [root.name, *path.relative_to(root).with_suffix('').parts]
            module = '.'.join(parts).removesuffix('.__init__')
            self.trees[module], self.paths[module] = ast.parse(path.read_text()), path
        self.classes = {
            node.name: (module, node) for module, tree in self.trees.items()
            for node in tree.body if isinstance(node, ast.ClassDef)}

    def resolve(self, module: str, name: str, depth: int = 0) -> Known | None:
        """Module and definition of a name used in a module; no definition for a module."""
        if module not in self.trees or depth > 6:
            return None
        for item in self.trees[module].body:
            if isinstance(item, (ast.FunctionDef, ast.ClassDef)) and item.name == name:
                return module, item
        for node in ast.walk(self.trees[module]):
            if isinstance(node, ast.ImportFrom) and (node.module or '').startswith(self.root.name):
                for alias in node.names:
                    if (alias.asname or alias.name) != name:
                        continue
                    inner = f'{node.module}.{alias.name}'
                    if inner in self.trees:
                        return inner, None
                    return self.resolve(node.module or '', alias.name, depth + 1)
        return None

    def method(self, owner: str, name: str) -> Place | None:
        """A method by the name of its class."""
        if owner not in self.classes:
            return None
        module, node = self.classes[owner]
        return next((Place(module, item, node) for item in node.body
                     if isinstance(item, ast.FunctionDef) and item.name == name), None)


@dataclass
class Walk:
    """The stops so far; holders: names of the types that hold the runs."""

    package: Package
    holders: set[str]
    stops: list[tuple[Path, list[str]]] = field(default_factory=list)
    seen: set[tuple[str, str, str]] = field(default_factory=set)

    def read(self, place: Place) -> None:
        """Read a function and, where it calls them, the functions that take the runs."""
        path = self.package.paths[place.module]
        self._stop(path, place.function.name)
        self.seen.add(place.key)
        for called in _calls(self.package, place):
            is_new = called.key not in self.seen and f'.{ENGINE}' in called.module
            if is_new and self._takes_runs(called):
                self.read(called)
                self._stop(path, RETURN)

    def _stop(self, path: Path, name: str) -> None:
        if not self.stops or self.stops[-1][0] != path:
            self.stops.append((path, []))
        if name != RETURN or not self.stops[-1][1]:
            self.stops[-1][1].append(name)

    def _takes_runs(self, place: Place) -> bool:
        if place.owner is not None and place.owner.name in self.holders:
            return True
        return any(_words(item.annotation) & self.holders for item in _arguments(place.function))


def holders_of(package: Package, kind: str) -> set[str]:
    """`kind` and the classes of the engine with a field of a type that holds it."""
    found, before = {kind}, 0
    while len(found) > before:
        before = len(found)
        for name, (module, node) in package.classes.items():
            if f'.{ENGINE}' in module and _fields(node) & found:
                found.add(name)
    return found


def _fields(node: ast.ClassDef) -> set[str]:
    """Names in the annotations of fields and of the constructor."""
    words: set[str] = set()
    for item in node.body:
        if isinstance(item, ast.AnnAssign):
            words |= _words(item.annotation)
        elif isinstance(item, ast.FunctionDef) and item.name == '__init__':
            words |= {word for one in _arguments(item) for word in _words(one.annotation)}
    return words


def _calls(package: Package, place: Place) -> Iterator[Place]:
    """Functions, methods and properties that a function uses, in the order of the code."""
    types = _types(package, place)
    used = [node for node in ast.walk(place.function)
            if isinstance(node, (ast.Call, ast.Attribute))]
    for node in sorted(used, key=lambda node: (node.end_lineno or 0, node.end_col_offset or 0)):
        target = node.func if isinstance(node, ast.Call) else node
        found = None
        if isinstance(node, ast.Call) and isinstance(target, ast.Name):
            found = _callable(package, package.resolve(place.module, target.id))
        elif isinstance(target, ast.Attribute) and isinstance(target.value, ast.Name):
            name = target.value.id
            if name == 'self' and place.owner is not None:
                found = package.method(place.owner.name, target.attr)
            elif name in types:
                found = next(filter(None, (
                    package.method(kind, target.attr) for kind in sorted(types[name]))), None)
            else:
                known = package.resolve(place.module, name)
                if known is not None and known[1] is None:
                    found = _callable(package, package.resolve(known[0], target.attr))
                elif known is not None and isinstance(known[1], ast.ClassDef):
                    found = package.method(known[1].name, target.attr)
        if found is not None:
            yield found


def _callable(package: Package, known: Known | None) -> Place | None:
    """The function of a name, or the constructor of a class."""
    if known is None:
        return None
    module, node = known
    if isinstance(node, ast.FunctionDef):
        return Place(module, node)
    if isinstance(node, ast.ClassDef):
        return package.method(node.name, '__init__') or package.method(node.name, '__post_init__')
    return None


def _types(package: Package, place: Place) -> dict[str, set[str]]:
    """Words of the types of arguments, and of variables that a known function returns."""
    types = {item.arg: _words(item.annotation) for item in _arguments(place.function)}
    for node in ast.walk(place.function):
        if not (isinstance(node, ast.Assign) and isinstance(node.value, ast.Call)):
            continue
        target, function = node.targets[0], node.value.func
        if isinstance(target, ast.Name) and isinstance(function, ast.Name):
            known = package.resolve(place.module, function.id)
            if known is not None and isinstance(known[1], ast.ClassDef):
                types[target.id] = {known[1].name}
            elif known is not None and isinstance(known[1], ast.FunctionDef):
                types[target.id] = _words(known[1].returns)
    return types


def _arguments(function: ast.FunctionDef) -> list[ast.arg]:
    given = function.args
    return [*given.posonlyargs, *given.args, *given.kwonlyargs]


def _words(node: ast.expr | None) -> set[str]:
    return set() if node is None else set(re.findall(r'\w+', ast.unparse(node)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('package', type=Path)
    parser.add_argument('entry', metavar='MODULE:FUNCTION')
    parser.add_argument('type')
    parser.add_argument('--show', action='store_true', help='list the stops')
    args = parser.parse_args()
    package = Package(args.package.resolve())
    module, _, name = args.entry.partition(':')
    start = _callable(package, package.resolve(f'{package.root.name}.{module}', name))
    if start is None:
        parser.error(f'{args.entry} is not in {args.package}')
    walk = Walk(package, holders_of(package, args.type))
    walk.read(start)
    while walk.stops[-1][1] == [RETURN]:
        walk.stops.pop()
    if args.show:
        for path, names in walk.stops:
            print(f'{path.relative_to(package.root)}: {", ".join(names)}')
    files = {path for path, _ in walk.stops}
    print(f'{len(walk.seen)} functions, {len(walk.stops)} stops in {len(files)} files, '
          f'{len(walk.stops) - len(files)} returns')


if __name__ == '__main__':
    main()
