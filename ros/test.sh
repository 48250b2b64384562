#!/usr/bin/env bash
# The tests of the ROS 2 node, in an environment of its own (ros/python.sh makes it): ros/test.sh [WHEELS]
# Without wheels of viewshed and viewshed-lab the checkout is taken, after make demo or without it. The messages of the C++ node
# are tested where VIEWSHED_LIBRARY names an installed libviewshed (docs/cpp.md).
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
[ -z "${1:-}" ] || export VIEWSHED_SOURCES=
"$here/python.sh" -c "" || { [ $? = 3 ] && echo "SKIPPED: the ROS 2 node was not tested" && exit 0; exit 1; }
if [ -n "${1:-}" ]; then
    "$here/python.sh" -m pip install --quiet --disable-pip-version-check --no-deps --force-reinstall "$@"
fi
cd "$here/viewshed_ros"
export PYTHONDONTWRITEBYTECODE=1
(cd "$here/viewshed_cpp" && "$here/python.sh" -m pytest test)
# Seen once: Fast DDS ended a participant and spun for ever (DomainParticipant::set_listener). What hangs is tried once more.
tests() { timeout --kill-after=10 600 "$here/python.sh" -m pytest; }
tests || case $? in 124 | 137) echo "the tests of the node hung; once more" >&2 && tests ;; *) exit 1 ;; esac
