"""The `saddlering` command: a module for each subcommand, found by walking this folder.

Commands that do the same to other curves share one. A subcommand's module has COMMANDS and
`run(args) -> int`, imports nothing heavy before `run`, and raises SaddleringError for each error
that its user can correct. The type of each argument that names a path (`_arguments.Role`) declares
whether it is read or written, that of a number (`Within`) its range.
"""
