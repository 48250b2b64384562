#!/usr/bin/env bash
# Python in the environment of the ROS 2 node (Python 3.11, ROS as wheels), made if it is not there: ros/python.sh WORDS
# The node and the library are those of this checkout; its native core is put beside its sources: that of make demo where
# its Python is 3.11 as well, else compiled here (two minutes). VIEWSHED_ROS_VENV names another folder for the
# environment; it exits with 3 where it cannot be made.
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)
venv=${VIEWSHED_ROS_VENV:-$root/.venv-ros}

skip() { echo "no environment for ROS 2: $*" >&2; exit 3; }

python=$(command -v python3.11 || command -v python3) || skip "there is no Python"
"$python" -c 'import sys, platform; sys.exit(sys.version_info[:2] != (3, 11) or platform.machine() != "x86_64")' ||
    skip "its wheels are pinned for Python 3.11 on x86-64"
if ! cmp -s "$root/ros/viewshed_ros/requirements.txt" "$venv/requirements.txt"; then
    "$python" -m venv --clear "$venv"
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --require-hashes \
        -r "$root/ros/viewshed_ros/requirements.txt" >"$venv/pip.log" 2>&1 || { tail -3 "$venv/pip.log" >&2; skip "the wheels of ROS cannot be had"; }
    cp "$root/ros/viewshed_ros/requirements.txt" "$venv/"
fi
# What objects and agents need is added to an environment that is there.
if ! cmp -s "$root/ros/viewshed_ros/requirements_agents.txt" "$venv/requirements_agents.txt"; then
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-deps --require-hashes \
        -r "$root/ros/viewshed_ros/requirements_agents.txt" >"$venv/pip.log" 2>&1 || { tail -3 "$venv/pip.log" >&2; skip "the wheels of agents cannot be had"; }
    cp "$root/ros/viewshed_ros/requirements_agents.txt" "$venv/"
fi
# The core (packages/viewshed/src/core/README.md), unless it is newer than its sources; VIEWSHED_SOURCES= takes an installed viewshed.
package=$root/packages/viewshed
core=$package/src/viewshed/_core.cpython-311-x86_64-linux-gnu.so
is_current() {
    [ -e "$1" ] && [ -z "$(find "$package/src/core" "$package/CMakeLists.txt" "$package/pyproject.toml" -name '*.[cht]*' -newer "$1" -print -quit)" ]
}
if [ -n "${VIEWSHED_SOURCES-checkout}" ] && ! is_current "$core"; then
    made=$(cd "$root" && .venv/bin/python -c 'import viewshed._core as core; print(core.__file__)' 2>/dev/null) || made=
    folder=$(mktemp -d) && trap 'rm -rf "$folder"' EXIT
    if [ "$(basename "$made")" != "$(basename "$core")" ] || [ "$made" = "$core" ] || ! is_current "$made"; then
        echo "compiling the core for the node's Python" >&2
        "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-deps --target "$folder" "$package" >&2
        made=$folder/viewshed/$(basename "$core")
    fi
    cp "$made" "$core.$$" && mv "$core.$$" "$core"
    rm -rf "$folder"
fi
# The wheels set these two for their own Python; what another one set would mislead it.
exec env -u LD_LIBRARY_PATH -u _ROS_WHEELS_BOOTSTRAP_COMPLETE \
    PYTHONPATH="${VIEWSHED_SOURCES-$package/src:$root/packages/viewshed-lab/src:}$root/ros/viewshed_ros:$root/packages/viewshed-lab" OMP_NUM_THREADS="${OMP_NUM_THREADS:-1}" \
    ROS_DOMAIN_ID="${ROS_DOMAIN_ID:-$((RANDOM % 100 + 1))}" ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST \
    FASTRTPS_DEFAULT_PROFILES_FILE="$root/ros/viewshed_ros/config/fastdds.xml" "$venv/bin/python" "$@"
