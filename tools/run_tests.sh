#!/bin/sh
# Runs all tests with the given pytest, in groups at the same time: while one waits for a
# server, a browser or a disk, the others use the processor. The command in CHECK, if
# there is one, runs at the same time; its output comes first. The tests that depend most
# on the database are run on PostgreSQL as well, if a server answers. With
# UNGHOST_TEST_DATABASE, all tests are run on that database only. The output of a group is
# printed when it has ended. The groups share one process that has imported everything
# (tests/support/template.py), from which they fork servers and commands.
set -u
work=$(mktemp -d)
trap 'kill $(cat "$work"/*.pid 2>/dev/null) 2>/dev/null; rm -rf "$work"' EXIT
trap 'exit 130' INT TERM

# The files and folders of a group.
paths() {
    case $1 in
    browser) echo tests/browser ;;
    service) echo tests/api tests/hostile --ignore=tests/api/cli ;;
    programs)
        echo tests/api/cli tests/cluster tests/durability tests/migrations
        echo tests/packaging tests/replicas tests/s3
        ;;
    others)
        for folder in tests/*/; do
            case ${folder%/} in
            tests/browser | tests/api | tests/hostile) ;;
            tests/cluster | tests/durability | tests/migrations) ;;
            tests/packaging | tests/replicas | tests/s3) ;;
            tests/__pycache__ | tests/data | tests/support) ;;
            *) echo "${folder%/}" ;;
            esac
        done
        ;;
    postgres)
        echo tests/unit/app/runs/test_runs.py tests/unit/app/exports/test_export_jobs.py
        echo tests/unit/app/boxes/test_statistics.py tests/unit/app/db/test_ids.py
        echo tests/unit/app/boxes/test_box_selection.py
        echo tests/property/app/review tests/property/app/ingest
        echo tests/api/test_main_path.py
        ;;
    esac
}

# check and run replace the subshell in which they are called.
check() {
    exec sh -c "$CHECK"
}

run() {
    group=$1
    shift
    if [ "$group" = postgres ]; then
        # The same tests on SQLite try more examples.
        export UNGHOST_TEST_DATABASE="$database" PROPERTY_EXAMPLES="${PROPERTY_EXAMPLES:-6}"
    fi
    # Only tests/hostile needs this plugin, which takes a second to import.
    [ "$group" = service ] || set -- "$@" -p no:schemathesis
    exec "$@" -o cache_dir="$work/$group" $(paths "$group")
}

groups="programs service browser others"
if [ -n "${UNGHOST_TEST_DATABASE:-}" ]; then
    echo "All tests on PostgreSQL."
elif database=$("$1" -m tests.support.databases); then
    groups="$groups postgres"
elif [ -n "${CI:-}" ]; then
    exit 1
else
    echo "The tests on PostgreSQL are skipped: no server answers."
fi

begin() {
    group=$1
    shift
    "$@" >"$work/$group.log" 2>&1 &
    echo $! >"$work/$group.pid"
}

# Waits for a group, prints its output, and returns its status.
end() {
    wait "$(cat "$work/$1.pid")"
    ended=$?
    rm "$work/$1.pid"
    cat "$work/$1.log"
    return "$ended"
}

OPENBLAS_NUM_THREADS=1 "$1" tests/support/template.py "$work/template" >/dev/null &
echo $! >"$work/template.pid"
until [ -S "$work/template" ] || ! kill -0 $! 2>/dev/null; do sleep 0.1; done
[ ! -S "$work/template" ] || export UNGHOST_TEST_TEMPLATE="$work/template"

[ -z "${CHECK:-}" ] || begin check check
for group in $groups; do
    begin "$group" run "$group" "$@"
done

outcome=0
if [ -n "${CHECK:-}" ] && ! end check; then
    echo "The checks have failed; the tests continue."
    outcome=1
fi
for group in $groups; do
    end "$group" || outcome=$?
done
exit "$outcome"
