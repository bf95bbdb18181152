#!/usr/bin/env bash
# Run the tests: those that start ROS nodes one after the other, all others on every core.
#
#   tools/test.sh [arguments of pytest]
#
# Nodes have deadlines to keep, a test that fills the other core would break them.
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

no_tests=5  # pytest's status when nothing was selected
failed=0
nothing=0

run() {
  tools/run.sh python -m pytest "$@"
  local status=$?
  case $status in
    0) ;;
    "$no_tests") nothing=$((nothing + 1)) ;;
    130 | 2) exit $status ;;
    *) failed=$status ;;
  esac
}

run -m 'not ros' --numprocesses auto --dist loadfile "$@"
run -m ros "$@"
[ "$nothing" -lt 2 ] || exit "$no_tests"
exit "$failed"
