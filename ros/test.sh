#!/usr/bin/env bash
# The tests of the ROS 2 node, in an environment of its own (Python 3.11, ROS as wheels): ros/test.sh [WHEEL]
# Without a wheel of viewshed the checkout is taken, whose native core must be built (make demo does it, or see docs/core.md).
set -euo pipefail
cd "$(dirname "$0")/.."
root=$PWD venv=${VIEWSHED_ROS_VENV:-$PWD/.venv-ros} wheel=${1:-}

skip() { echo "SKIPPED: the ROS 2 node was not tested: $*"; exit 0; }

python=$(command -v python3.11 || command -v python3) || skip "there is no Python"
"$python" -c 'import sys, platform; sys.exit(sys.version_info[:2] != (3, 11) or platform.machine() != "x86_64")' ||
    skip "its wheels are pinned for Python 3.11 on x86-64"
if ! cmp -s ros/viewshed_ros/requirements.txt "$venv/requirements.txt"; then
    "$python" -m venv --clear "$venv"
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --require-hashes -r ros/viewshed_ros/requirements.txt \
        >"$venv/pip.log" 2>&1 || { tail -3 "$venv/pip.log"; skip "the wheels of ROS cannot be had"; }
    cp ros/viewshed_ros/requirements.txt "$venv/"
fi
sources=$root/ros/viewshed_ros
if [ -n "$wheel" ]; then
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-deps --force-reinstall "$wheel"
else
    sources=$root/src:$sources
fi
cd ros/viewshed_ros
# The wheels set these two for their own Python; what another one set would mislead it.
exec env -u LD_LIBRARY_PATH -u _ROS_WHEELS_BOOTSTRAP_COMPLETE PYTHONPATH="$sources" PYTHONDONTWRITEBYTECODE=1 OMP_NUM_THREADS=1 \
    ROS_DOMAIN_ID="${ROS_DOMAIN_ID:-$((RANDOM % 100 + 1))}" ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST \
    FASTRTPS_DEFAULT_PROFILES_FILE="$PWD/config/fastdds.xml" "$venv/bin/python" -m pytest
