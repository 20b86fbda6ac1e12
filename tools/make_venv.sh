#!/bin/sh
# Makes the virtual environment $1 with whatever this machine offers: Python 3.10 or
# newer with venv, else virtualenv, else apt's python3-venv.
set -eu

venv=$1

is_new_enough() {
    "$1" -c 'import sys; sys.exit(sys.version_info < (3, 10))' 2>/dev/null
}

find_python() {
    for candidate in ${PYTHON:-} python3 python3.13 python3.12 python3.11 python3.10 python; do
        if command -v "$candidate" >/dev/null 2>&1 && is_new_enough "$candidate"; then
            command -v "$candidate"
            return
        fi
    done
    echo "Unghost needs Python 3.10 or newer; none was found (set PYTHON=/path/to/python)." >&2
    exit 1
}

as_root() {
    if [ "$(id -u)" = 0 ]; then "$@"; else sudo "$@"; fi
}

with_venv() {
    rm -rf "$venv"
    "$python" -m venv "$venv" >/dev/null 2>&1
}

with_virtualenv() {
    rm -rf "$venv"
    "$python" -m virtualenv --quiet "$venv" >/dev/null 2>&1
}

with_fetched_virtualenv() {
    fetched=build/virtualenv
    "$python" -m pip install --quiet --target "$fetched" virtualenv >/dev/null 2>&1 || return 1
    rm -rf "$venv"
    PYTHONPATH=$fetched "$python" -m virtualenv --quiet "$venv"
}

with_apt() {
    command -v apt-get >/dev/null 2>&1 || return 1
    version=$("$python" -c 'import sys; print("%d.%d" % sys.version_info[:2])')
    echo "Installing python3-venv with apt-get ..." >&2
    as_root env DEBIAN_FRONTEND=noninteractive sh -c \
        "apt-get update -q && { apt-get install -qy python$version-venv || apt-get install -qy python3-venv; }" \
        </dev/null >&2 || return 1
    with_venv
}

python=$(find_python)
with_venv || with_virtualenv || with_fetched_virtualenv || with_apt || {
    echo "No way to make a virtual environment: install python3-venv (or virtualenv) and run make again." >&2
    exit 1
}
