#!/usr/bin/env bash
# Lay both packages side by side in a colcon workspace, so that rosdep and colcon need no flags.
#
#   tools/workspace.sh FOLDER
#
# FOLDER/src gets a link to each package. In the repository itself the messages lie below the
# package that uses them, where neither rosdep nor colcon looks.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)

[ $# = 1 ] && [ -n "$1" ] || {
  echo 'workspace: give a folder: make workspace WS=~/saddlering_ws' >&2
  exit 2
}
workspace=$1
case "$(realpath -m "$workspace")/" in "$here"/*)
  echo "workspace: $workspace lies in the repository: give a folder outside" >&2
  exit 2 ;;
esac
mkdir -p "$workspace/src"
for package in saddlering_ros:. saddlering_interfaces:saddlering_interfaces; do
  link=$workspace/src/${package%%:*}
  if [ -e "$link" ] && [ ! -L "$link" ]; then
    echo "workspace: $link is there already and no link: move it away" >&2
    exit 2
  fi
  ln -sfn "$(cd "$here/${package#*:}" && pwd -P)" "$link"
done
cat << EOF
$workspace/src holds both packages. On a ROS 2 Jazzy that is sourced:
  cd $workspace
  rosdep install --from-paths src --ignore-src -y
  colcon build
  source install/setup.bash
  ros2 launch saddlering_ros rig.launch.py
EOF
