"""The `saddlering` command: one module per subcommand, found by walking this folder.

A subcommand's module has `add_parser(subparsers)`, `run(args) -> int` and `EXAMPLES`, imports
nothing heavy before `run`, and raises SaddleringError for each error that its user can correct.
The type of each argument that names a path (`_arguments.ROLES`) declares whether it is read or
written. UNTRIED states why no test types the examples of a command.
"""
