#!/bin/sh
# All tests, with the given pytest, in groups beside each other: each leaves time to
# the others while it waits for a server, a browser or a disk. The command in CHECK, if
# any, runs beside them, and what it found is said first. What tells most about the
# database is run on PostgreSQL as well; with UNGHOST_TEST_DATABASE everything is, and
# only there. The output of a group comes when it is complete.
set -u
work=$(mktemp -d)
trap 'kill $(cat "$work"/*.pid 2>/dev/null) 2>/dev/null; rm -rf "$work"' EXIT
trap 'exit 130' INT TERM

# What a group consists of, for pytest; each collects its own folders only.
paths() {
    case $1 in
    browser) echo tests/browser tests/replicas ;;
    service) echo tests/api tests/durability tests/hostile ;;
    others)
        for folder in tests/*/; do
            case ${folder%/} in
            tests/browser | tests/replicas) ;;
            tests/api | tests/durability | tests/hostile) ;;
            tests/__pycache__ | tests/data | tests/support) ;;
            *) echo "${folder%/}" ;;
            esac
        done
        ;;
    postgres)
        echo tests/unit/app/runs/test_runs.py tests/unit/app/exports
        echo tests/unit/app/boxes/test_statistics.py tests/unit/app/db/test_ids.py
        echo tests/unit/app/boxes/test_box_selection.py
        echo tests/property/app/review tests/property/app/ingest
        echo tests/api/test_main_path.py
        ;;
    esac
}

# Both in place of the (sub)shell that calls them.
check() {
    exec sh -c "$CHECK"
}

run() {
    group=$1
    shift
    [ "$group" != postgres ] || export UNGHOST_TEST_DATABASE="$database"
    exec "$@" -o cache_dir="$work/$group" $(paths "$group")
}

groups="others service browser"
if [ -n "${UNGHOST_TEST_DATABASE:-}" ]; then
    echo "All tests on PostgreSQL."
elif database=$("$1" -m tests.support.databases); then
    groups="$groups postgres"
elif [ -n "${CI:-}" ]; then
    exit 1
else
    echo "The tests on PostgreSQL are left out."
fi

begin() {
    group=$1
    shift
    "$@" >"$work/$group.log" 2>&1 &
    echo $! >"$work/$group.pid"
}

# Says what a group has said, when it is complete; its status.
end() {
    wait "$(cat "$work/$1.pid")"
    ended=$?
    rm "$work/$1.pid"
    cat "$work/$1.log"
    return "$ended"
}

[ -z "${CHECK:-}" ] || begin check check
for group in $groups; do
    begin "$group" run "$group" "$@"
done

outcome=0
if [ -n "${CHECK:-}" ] && ! end check; then
    echo "The checks have failed; the tests go on."
    outcome=1
fi
for group in $groups; do
    end "$group" || outcome=$?
done
exit "$outcome"
