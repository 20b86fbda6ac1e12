#!/bin/sh
# All tests, with the given pytest, in groups beside each other: each leaves time to
# the others while it waits for a server, a browser or a disk. The command in CHECK, if
# any, runs beside them, and what it found is said first. What tells most about the
# database is run on PostgreSQL as well; with UNGHOST_TEST_DATABASE everything is, and
# only there. The output of a group comes when it is complete. A test that fails beside
# so much else is run once more, with the machine to itself: what fails then is wrong and
# not merely late. Both reports are printed.
set -u
work=$(mktemp -d)
trap 'kill $(cat "$work"/*.pid 2>/dev/null) 2>/dev/null; rm -rf "$work"' EXIT
trap 'exit 130' INT TERM

# What needs a service and is left to another group, to make all equally long. The
# server that speaks S3 takes as long to start as many tests: only one group needs it.
BESIDE_BROWSER=tests/api/replicas
BESIDE_OTHERS=tests/api/s3

# What a group consists of, for pytest.
paths() {
    case $1 in
    browser) echo tests/browser $BESIDE_BROWSER ;;
    service)
        echo tests/api tests/hostile
        printf ' --ignore=%s' $BESIDE_BROWSER $BESIDE_OTHERS
        ;;
    others)
        echo tests --ignore=tests/browser --ignore=tests/hostile
        for one in tests/api/test_*.py tests/api/*/; do
            [ "${one%/}" = $BESIDE_OTHERS ] || echo "--ignore=${one%/}"
        done
        ;;
    postgres)
        for one in runs export_jobs statistics box_selection ids; do
            echo "tests/unit/app/test_$one.py"
        done
        for one in queue_order batches_like_uploads; do
            echo "tests/property/app/test_$one.py"
        done
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
elif database=$("$1" -m tests.databases); then
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
failed=
for group in $groups; do
    end "$group"
    status=$?
    # Status 1 is failed tests; any other is a run that did not get so far as to name them.
    case $status in
    0) ;;
    1) failed="$failed $group" ;;
    *) exit "$status" ;;
    esac
done

for group in $failed; do
    echo "Once more, alone: what failed beside the other tests ($group)."
    (run "$group" "$@" --last-failed --last-failed-no-failures=none) || outcome=1
done
exit "$outcome"
