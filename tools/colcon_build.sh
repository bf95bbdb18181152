#!/usr/bin/env bash
# Build both packages by colcon, side by side in a workspace, as a machine with ROS 2 does.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
python=$here/.venv/bin/python
prefix=$here/.venv
[ "$(cat "$prefix/stamps/ros")" = wheels ] || prefix=$AMENT_PREFIX_PATH

workspace=$(mktemp -d)
trap 'rm -rf "$workspace"' EXIT
"$here/tools/workspace.sh" "$workspace" > "$workspace/said"
"$(cat "$here/.venv/stamps/python")" -m venv "$workspace/tools"
"$workspace/tools/bin/pip" install --quiet --disable-pip-version-check -r "$here/requirements/colcon.in"

cd "$workspace"
env "AMENT_PREFIX_PATH=$prefix" "CMAKE_PREFIX_PATH=$prefix" "PATH=$here/.venv/bin:$PATH" \
  tools/bin/colcon build --cmake-args -DBUILD_TESTING=OFF \
  "-DPython3_EXECUTABLE=$python" -DPython3_FIND_VIRTUALENV=ONLY
test -x install/saddlering_ros/lib/saddlering_ros/ring_residual
test -f install/saddlering_ros/share/saddlering_ros/launch/rig.launch.py
test -f install/saddlering_interfaces/share/saddlering_interfaces/msg/RingDisplacement.msg
