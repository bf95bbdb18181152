"""The executables: one module per node, thin over `streams`, `jobs` and `ros`."""
