"""The `saddlering` command: one module per subcommand, found by walking this folder.

A subcommand's module has `add_parser(subparsers)` and `run(args) -> int`, imports nothing heavy
before `run`, and raises SaddleringError for each error that its user can correct.
"""
