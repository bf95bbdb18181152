#!/usr/bin/env bash
# The gate's tests: first those without ROS on every core, then those that start nodes, in turn.
#
#   tools/test.sh [arguments of pytest]
#
# Nodes have deadlines to keep: beside other tests some would miss them.
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

with_nodes=(test/nodes test/live test/cli)  # a test marked ros elsewhere is refused (conftest.py)
no_tests=5  # pytest's status when nothing was selected
failed=0
nothing=0

run() {
  tools/run.sh python -m pytest --quiet --dist worksteal "$@"
  local status=$?
  case $status in
    0) ;;
    "$no_tests") nothing=$((nothing + 1)) ;;
    130 | 2) exit $status ;;
    *) failed=$status ;;
  esac
}

run -m 'not ros' --numprocesses auto "$@"
run -m ros --numprocesses 0 "${@:-${with_nodes[@]}}"
[ "$nothing" -lt 2 ] || exit "$no_tests"
exit "$failed"
