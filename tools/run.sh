#!/usr/bin/env bash
# Run a command in the environment that set_up.sh made, whatever else this shell has sourced.
set -euo pipefail
environment=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)/.venv
if [ "$(cat "$environment/stamps/ros")" = wheels ]; then
  unset PYTHONPATH PYTHONHOME LD_LIBRARY_PATH AMENT_PREFIX_PATH CMAKE_PREFIX_PATH
  unset _ROS_WHEELS_BOOTSTRAP_COMPLETE
fi
export PATH=$environment/bin:$PATH
exec "$@"
