"""Stops and returns of a reader who follows the runs through the engine, from the code alone.

    python benchmarks/reading_walk.py [--package DIR] [--show]

The reader begins at `diagnose_system` and reads each function of the engine at its first call, in
the order of the code, if it takes the runs: a parameter or the object of the method is of the type
RunBlocks, or of a class with a field that holds it. After each function the reader returns to the
caller. A stop is a stay in one file; a return is a stop in a file that was left before. DIR may be
that of an older checkout, whose entry and type other options name.
"""

import ast
from collections.abc import Iterator
from pathlib import Path
import re

from frame import arguments, ROOT

ENGINE = '.discrepancy'
Definition = ast.FunctionDef | ast.ClassDef


def words(node: ast.expr | None) -> set[str]:
    """Names in an annotation."""
    return set() if node is None else set(re.findall(r'\w+', ast.unparse(node)))


def parameters(function: ast.FunctionDef) -> list[ast.arg]:
    given = function.args
    return [*given.posonlyargs, *given.args, *given.kwonlyargs]


class Walk:
    """The syntax trees of a package; the stops of the reader so far, each a file and its names.

    holders: names of the types that hold the runs.
    """

    def __init__(self, root: Path, held: str) -> None:
        self.name = root.name
        self.paths = {
            '.'.join([root.name, *path.relative_to(root).with_suffix('').parts]).removesuffix(
                '.__init__'): path for path in sorted(root.rglob('*.py'))}
        self.trees = {module: ast.parse(path.read_text()) for module, path in self.paths.items()}
        # A class of the engine hides one of the same name elsewhere.
        engine_last = sorted(self.trees.items(), key=lambda item: ENGINE in item[0])
        self.classes = {node.name: (module, node) for module, tree in engine_last
                        for node in tree.body if isinstance(node, ast.ClassDef)}
        self.holders, before = {held}, 0
        while len(self.holders) > before:
            before = len(self.holders)
            self.holders |= {name for name, (module, node) in self.classes.items()
                             if ENGINE in module and self.fields(node) & self.holders}
        self.seen: set[ast.FunctionDef] = set()
        self.stops: list[tuple[str, list[str]]] = []

    @staticmethod
    def fields(node: ast.ClassDef) -> set[str]:
        """Names in the annotations of fields and of the constructor."""
        made = [item for item in node.body
                if isinstance(item, ast.FunctionDef) and item.name == '__init__']
        notes = [item.annotation for item in node.body if isinstance(item, ast.AnnAssign)]
        notes += [one.annotation for item in made for one in parameters(item) if one.annotation]
        return {word for note in notes for word in words(note)}

    def resolve(self, module: str, name: str) -> tuple[str, Definition | None] | None:
        """Module and definition of a name used in a module; no definition for a module."""
        for node in ast.walk(self.trees.get(module, ast.Module([], []))):
            if isinstance(node, Definition) and node.name == name and (
                    node in self.trees[module].body):
                return module, node
            if not (isinstance(node, ast.ImportFrom) and (node.module or '').startswith(
                    self.name)):
                continue
            for alias in node.names:
                if (alias.asname or alias.name) != name:
                    continue
                inner = f'{node.module}.{alias.name}'
                return (inner, None) if inner in self.trees else self.resolve(
                    node.module or '', alias.name)
        return None

    def method(self, owner: str, name: str) -> tuple[str, ast.FunctionDef, str] | None:
        """Module, function and class of a method by the name of its class."""
        module, node = self.classes.get(owner, ('', None))
        return next(((module, item, owner) for item in (node.body if node else ())
                     if isinstance(item, ast.FunctionDef) and item.name == name), None)

    def function(self, module: str, name: str) -> tuple[str, ast.FunctionDef, str] | None:
        """The function of a name, or the constructor of a class."""
        known = self.resolve(module, name)
        if known is None or known[1] is None:
            return None
        if isinstance(known[1], ast.FunctionDef):
            return known[0], known[1], ''
        return self.method(known[1].name, '__init__') or self.method(
            known[1].name, '__post_init__')

    def types(self, module: str, function: ast.FunctionDef) -> dict[str, set[str]]:
        """Words of the types of arguments, and of variables that a known function returns."""
        found = {item.arg: words(item.annotation) for item in parameters(function)}
        for node in ast.walk(function):
            if isinstance(node, ast.Assign) and isinstance(node.value, ast.Call) and isinstance(
                    node.targets[0], ast.Name) and isinstance(node.value.func, ast.Name):
                known = (self.resolve(module, node.value.func.id) or (None, None))[1]
                if known is not None:
                    found[node.targets[0].id] = {known.name} if isinstance(
                        known, ast.ClassDef) else words(known.returns)
        return found

    def calls(self, module: str, function: ast.FunctionDef, owner: str,
              ) -> Iterator[tuple[str, ast.FunctionDef, str]]:
        """Functions, methods and properties that a function uses, in the order of the code."""
        types = self.types(module, function)
        if owner:
            types['self'] = {owner}
        used = [node for node in ast.walk(function) if isinstance(node, (ast.Call, ast.Attribute))]
        for node in sorted(used, key=lambda node: (node.end_lineno, node.end_col_offset)):
            target, found = node.func if isinstance(node, ast.Call) else node, None
            if isinstance(node, ast.Call) and isinstance(target, ast.Name):
                found = self.function(module, target.id)
            elif isinstance(target, ast.Attribute) and isinstance(target.value, ast.Name):
                name = target.value.id
                known = None if name in types else self.resolve(module, name)
                if known is not None and known[1] is None:
                    found = self.function(known[0], target.attr)
                else:
                    owners = {known[1].name} if known else types.get(name, set())
                    found = next(filter(None, (self.method(kind, target.attr)
                                               for kind in sorted(owners))), None)
            if found is not None:
                yield found

    def read(self, module: str, function: ast.FunctionDef, owner: str) -> None:
        """Read a function and, where it calls them, the functions that take the runs."""
        self.stop(module, function.name)
        self.seen.add(function)
        for called in self.calls(module, function, owner):
            takes_runs = called[2] in self.holders or any(
                words(item.annotation) & self.holders for item in parameters(called[1]))
            if called[1] not in self.seen and ENGINE in called[0] and takes_runs:
                self.read(*called)
                self.stop(module, '')

    def stop(self, module: str, name: str) -> None:
        if not self.stops or self.stops[-1][0] != module:
            self.stops.append((module, []))
        if name:
            self.stops[-1][1].append(name)


def main() -> None:
    args = arguments(__doc__, {}, package=ROOT / 'saddlering_ros', module='discrepancy.engine',
                     function='diagnose_system', type='RunBlocks', show=False)
    walk = Walk(args.package.resolve(), args.type)
    start = walk.function(f'{walk.name}.{args.module}', args.function)
    if start is None:
        raise SystemExit(f'{args.module}:{args.function} is not in {args.package}')
    walk.read(*start)
    while not walk.stops[-1][1]:
        walk.stops.pop()
    if args.show:
        for module, names in walk.stops:
            print(f'{module}: {", ".join(names) or "..."}')
    files = {module for module, _ in walk.stops}
    print(f'{len(walk.seen)} functions, {len(walk.stops)} stops in {len(files)} files, '
          f'{len(walk.stops) - len(files)} returns')


if __name__ == '__main__':
    main()
