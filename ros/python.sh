#!/usr/bin/env bash
# Python in the environment of the ROS 2 node (Python 3.11, ROS as wheels), made if it is not there: ros/python.sh WORDS
# The node and the library are those of this checkout, whose native core must be built (make demo does it, or see
# docs/core.md). VIEWSHED_ROS_VENV names another folder for the environment; it exits with 3 where it cannot be made.
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
# The wheels set these two for their own Python; what another one set would mislead it.
exec env -u LD_LIBRARY_PATH -u _ROS_WHEELS_BOOTSTRAP_COMPLETE \
    PYTHONPATH="${VIEWSHED_SOURCES-$root/src:}$root/ros/viewshed_ros:$root" OMP_NUM_THREADS="${OMP_NUM_THREADS:-1}" \
    ROS_DOMAIN_ID="${ROS_DOMAIN_ID:-$((RANDOM % 100 + 1))}" ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST \
    FASTRTPS_DEFAULT_PROFILES_FILE="$root/ros/viewshed_ros/config/fastdds.xml" "$venv/bin/python" "$@"
