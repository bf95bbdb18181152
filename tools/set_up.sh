#!/usr/bin/env bash
# Make .venv: Python, ROS 2 Jazzy (wheels, or the one already sourced), our interfaces, this package.
#
#   tools/set_up.sh          what running needs
#   tools/set_up.sh test     and what the tests need
#   tools/set_up.sh coverage and what measures them
#
# Every step leaves a stamp when it is finished, holding a digest of all it depends on. A step whose
# stamp still holds is skipped, so a second run does nothing, and a run that was cut short goes on
# where it stopped. PYTHON=/path/to/python3 chooses the Python and is remembered.
set -euo pipefail

here=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
cd "$here"
environment=$here/.venv
stamps=$environment/stamps
log=$environment/set-up.log
python=$environment/bin/python

fail() {
  echo "set-up: $*" >&2
  exit 1
}

# --- Which Python and which ROS -------------------------------------------------------------------

version_of() {
  "$1" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null || true
}

usable_version() {
  case $1 in 3.10 | 3.11 | 3.12 | 3.13) return 0 ;; *) return 1 ;; esac
}

# The Python of an earlier set-up, so that PYTHON need not be given again; but a Jazzy sourced since
# then has a Python of its own.
remembered_python() {
  if [ "${ROS_DISTRO:-}" = jazzy ] && [ "$(cat "$stamps/ros" 2>/dev/null)" != jazzy ]; then return; fi
  cat "$stamps/python" 2>/dev/null || true
}

find_python() {
  local candidate
  if [ -n "${PYTHON:-}" ]; then
    base_python=$(command -v "$PYTHON") || fail "PYTHON=$PYTHON: no such program"
    base_version=$(version_of "$base_python")
    usable_version "$base_version" ||
      fail "PYTHON=$PYTHON is Python ${base_version:-unknown}; 3.10 to 3.13 is needed"
    return
  fi
  for candidate in $(remembered_python) python3 python3.12 python3.11 python3.13 python3.10; do
    base_python=$(command -v "$candidate") || continue
    base_version=$(version_of "$base_python")
    if usable_version "$base_version"; then return; fi
  done
  fail "no Python 3.10 to 3.13 found: sudo apt install python3 python3-venv python3-dev" \
    "(or name one: make setup PYTHON=/path/to/python3)"
}

jazzy_is_sourced() {
  [ "${ROS_DISTRO:-}" = jazzy ] && [ -n "${AMENT_PREFIX_PATH:-}" ] &&
    "$base_python" -c 'import rclpy' 2>/dev/null
}

find_ros() {
  if jazzy_is_sourced; then
    ros=jazzy
    ros_prefix=$AMENT_PREFIX_PATH
    return
  fi
  ros=wheels
  ros_prefix=$environment
  if [ "${ROS_DISTRO:-}" = jazzy ] && [ -n "${AMENT_PREFIX_PATH:-}" ]; then
    echo "set-up: ROS 2 Jazzy is sourced, but $base_python cannot import its rclpy: using wheels"
  elif [ -n "${ROS_DISTRO:-}" ]; then
    echo "set-up: ROS 2 $ROS_DISTRO is sourced; Jazzy is needed: using wheels beside it"
  fi
  case $(uname -s)-$(uname -m) in
    Linux-x86_64) ;;
    *) fail "the wheels of ROS 2 are for x86-64 Linux only: source a ROS 2 Jazzy first" ;;
  esac
}

# --- Steps and their stamps -----------------------------------------------------------------------

digest() { # of the arguments' words, then of standard input
  { printf '%s\n' "$@"; cat; } | sha256sum | cut -d ' ' -f 1
}

digest_of_files() {
  find "$@" -type f -not -path '*/__pycache__/*' -print0 | LC_ALL=C sort -z |
    xargs -0 sha256sum
}

done_already() {
  [ "$(cat "$stamps/$1" 2>/dev/null)" = "$2" ] && return
  [ -z "${SADDLERING_SET_UP_CHECK:-}" ] || { echo "set-up: $1 is out of date" >&2; exit 3; }
  return 1
}

mark_done() {
  mkdir -p "$stamps"
  printf '%s\n' "$2" > "$stamps/$1"
}

quietly() { # what failed, command...
  local what=$1
  shift
  if "$@" >> "$log" 2>&1; then return; fi
  tail -n 20 "$log" >&2
  fail "$what failed; the lines above are the end of $log"
}

need_venv_module() {
  "$base_python" -c 'import ensurepip, venv' 2>/dev/null && return
  local package=python3-venv
  case $(basename "$base_python") in python3.*) package=$(basename "$base_python")-venv ;; esac
  fail "$base_python cannot make environments: sudo apt install $package"
}

need_compilers() {
  local header package=python3-dev
  command -v "${CC:-gcc}" > /dev/null || command -v "${CC:-cc}" > /dev/null ||
    command -v "${CC:-clang}" > /dev/null || fail 'no C compiler: sudo apt install gcc g++'
  command -v "${CXX:-g++}" > /dev/null || command -v "${CXX:-c++}" > /dev/null ||
    command -v "${CXX:-clang++}" > /dev/null || fail 'no C++ compiler: sudo apt install g++'
  header=$("$base_python" -c 'import sysconfig; print(sysconfig.get_path("include"))')/Python.h
  case $(basename "$base_python") in python3.*) package=$(basename "$base_python")-dev ;; esac
  [ -f "$header" ] || fail "no $header to compile against: sudo apt install $package"
  [ "$ros" = wheels ] || command -v cmake > /dev/null || fail 'no CMake: sudo apt install cmake make'
}

make_environment() {
  local wanted
  wanted=$(digest "$environment" "$base_python" "$base_version" "$ros" "$ros_prefix" < /dev/null)
  if done_already environment "$wanted" && "$python" -c '' 2> /dev/null; then return; fi
  need_venv_module
  need_compilers
  echo "set-up: Python $base_version and ROS 2 Jazzy ($ros) into .venv"
  rm -rf "$environment"
  mkdir -p "$environment"
  local options=()
  [ "$ros" = wheels ] || options=(--system-site-packages)
  quietly 'making the environment' "$base_python" -m venv ${options[@]+"${options[@]}"} "$environment"
  mark_done ros "$ros"
  mark_done python "$base_python"
  mark_done environment "$wanted"
}

# pip, given exact versions: nothing is left to resolve. As root it fails where its cache cannot be
# written, as in a container with a home that is read-only.
install() {
  local cache options=()
  cache=$("$python" -m pip cache dir)
  mkdir -p "$cache" 2> /dev/null && [ -w "$cache" ] || options=(--no-cache-dir)
  "$python" -m pip install --disable-pip-version-check --no-input --no-deps \
    ${options[@]+"${options[@]}"} "$@"
}

install_locked() { # stamp, lock file, words to show
  local wanted lock=requirements/lock/$2.txt
  [ -f "$lock" ] || fail "$lock is missing: Python $base_version with ROS 2 ($ros) is not provided for"
  wanted=$(digest "$1" < "$lock")
  done_already "$1" "$wanted" && return
  echo "set-up: $3"
  if grep -q '^setuptools==' "$lock"; then
    quietly 'installing pip and setuptools' install $(grep -E '^(pip|setuptools)==' "$lock")
  fi
  quietly 'installing packages' install --no-build-isolation -r "$lock"
  mark_done "$1" "$wanted"
}

build_interfaces() {
  local wanted build
  wanted=$({ digest_of_files saddlering_interfaces; cat "$stamps/packages"; } | digest "$ros_prefix")
  done_already interfaces "$wanted" && return
  need_compilers
  echo 'set-up: building the messages and actions (saddlering_interfaces)'
  build=$environment/build/saddlering_interfaces
  rm -rf "$build"
  local generator=()
  [ -x "$environment/bin/ninja" ] && generator=(-G Ninja)
  local cmake=(env "AMENT_PREFIX_PATH=$ros_prefix" "CMAKE_PREFIX_PATH=${ros_prefix//:/;}"
    "PATH=$environment/bin:$PATH" cmake)
  quietly 'configuring saddlering_interfaces' "${cmake[@]}" -S saddlering_interfaces -B "$build" \
    ${generator[@]+"${generator[@]}"} -DCMAKE_BUILD_TYPE=Release -DBUILD_TESTING=OFF \
    -DCMAKE_INSTALL_PREFIX="$environment" -DCMAKE_INSTALL_RPATH="$environment/lib" \
    -DPython3_EXECUTABLE="$python" -DPython3_FIND_VIRTUALENV=ONLY
  quietly 'building saddlering_interfaces' "${cmake[@]}" --build "$build" --parallel
  quietly 'installing saddlering_interfaces' "${cmake[@]}" --install "$build"
  rm -rf "$build"
  mark_done interfaces "$wanted"
}

shared_files() {
  find package.xml config launch bags -type f -not -path '*/__pycache__/*' | LC_ALL=C sort
}

# Editable: what stands in the working tree is what runs. An editable install leaves out what ROS
# tools look for under lib/ and share/: links to the commands and to the working tree put it there.
install_package() {
  local wanted program shared
  wanted=$({ digest_of_files setup.py setup.cfg package.xml resource requirements/*.in \
      saddlering_ros/ros/names.py; shared_files; } | digest "$environment")
  done_already package "$wanted" && return
  echo 'set-up: installing saddlering_ros'
  quietly 'installing saddlering_ros' install --no-build-isolation --editable .
  mkdir -p "$environment"/{lib,share}/saddlering_ros
  for program in $("$python" -c 'from importlib.metadata import distribution
for entry in distribution("saddlering_ros").entry_points: print(entry.name)'); do
    ln -sfn "../../bin/$program" "$environment/lib/saddlering_ros/$program"
  done
  # Links to files, not to folders: ros2 launch walks the folders and follows no link on its way.
  rm -rf "$environment/share/saddlering_ros"
  for shared in $(shared_files); do
    mkdir -p "$environment/share/saddlering_ros/$(dirname "$shared")"
    ln -sfn "$here/$shared" "$environment/share/saddlering_ros/$shared"
  done
  ln -sfn "$here/resource/saddlering_ros" \
    "$environment/share/ament_index/resource_index/packages/saddlering_ros"
  mark_done package "$wanted"
}

# Once, so that no node and no command spends its first seconds compiling.
compile_kernels() {
  local wanted
  wanted=$({ digest_of_files saddlering_ros/ring; cat "$stamps/packages"; } | digest kernels)
  done_already kernels "$wanted" && return
  echo 'set-up: compiling the ring simulator'
  quietly 'compiling the ring simulator' "$python" -m saddlering_ros.ring.warm
  mark_done kernels "$wanted"
}

main() {
  find_python
  find_ros
  if [ "$ros" = wheels ]; then
    # Nothing of another ROS, nor of another environment's Python, may reach ours.
    unset PYTHONPATH PYTHONHOME LD_LIBRARY_PATH AMENT_PREFIX_PATH CMAKE_PREFIX_PATH
    unset _ROS_WHEELS_BOOTSTRAP_COMPLETE
  fi
  make_environment
  install_locked packages "$base_version-$ros" 'installing the pinned packages'
  build_interfaces
  install_package
  compile_kernels
  case ${1:-} in test | coverage)
    install_locked test_packages "$base_version-test" 'installing what the tests need' ;;
  esac
  if [ "${1:-}" = docs ]; then
    install_locked docs_packages "$base_version-docs" 'installing what the documentation needs'
  fi
  if [ "${1:-}" = coverage ]; then
    install_locked coverage_packages "$base_version-coverage" 'installing what measures the tests'
  fi
}

trap 'echo; echo "set-up: interrupted; the next run goes on from here" >&2; exit 130' INT TERM

# One set-up at a time; a second one waits, then finds everything done.
exec 9< "${BASH_SOURCE[0]}"
if command -v flock > /dev/null; then flock 9; fi
main "$@"
