#!/usr/bin/env bash
# The gate's tests: those without ROS on every core, and beside them those that start nodes, in turn.
#
#   tools/test.sh [arguments of pytest]
#
# Nodes need a core for a part of the time only; their tests wait for what must come, however long
# it takes, so that other tests beside them do no harm.
set -uo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."

with_nodes=(test/nodes test/live test/cli)  # a test marked ros elsewhere is refused (conftest.py)
no_tests=5  # pytest's status when nothing was selected

pytest=(tools/run.sh python -m pytest --quiet)

# A test run starts hundreds of processes; without kept bytecode, each would compile the package.
unset PYTHONDONTWRITEBYTECODE

# Two workers and the nodes share the cores: threads of one would only wait for another, and those
# of BLAS compute while they wait.
export SADDLERING_THREADS=${SADDLERING_THREADS:-1} OPENBLAS_NUM_THREADS=1

# Compiled once, before several processes ask for it.
tools/run.sh python -m saddlering_ros.ring.warm > /dev/null || exit

said=$(mktemp)
(exec "${pytest[@]}" -m ros --numprocesses 0 "${@:-${with_nodes[@]}}") > "$said" 2>&1 &
nodes=$!
end_nodes() {
  local number
  for number in INT TERM KILL; do  # a command under test takes one of them for its own
    kill "-$number" "$nodes" 2> /dev/null || break
    for _ in {1..100}; do
      kill -0 "$nodes" 2> /dev/null || break
      sleep 0.1
    done
  done
  rm -f "$said"
}
trap end_nodes EXIT
trap 'exit 130' INT TERM
# Nodes wait for each other and come first where they can compute: their part would else end last,
# with a core idle.
(exec nice -n 10 "${pytest[@]}" -m 'not ros' --numprocesses auto --dist worksteal "$@")
without=$?
[ "$without" != 2 ] || exit 2
wait "$nodes"
with=$?
echo
echo 'With nodes:'
cat "$said"
[ "$without" = "$no_tests" ] && [ "$with" = "$no_tests" ] && exit "$no_tests"
for status in "$without" "$with"; do
  [ "$status" = 0 ] || [ "$status" = "$no_tests" ] || exit "$status"
done
