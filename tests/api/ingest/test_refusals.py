"""The message of a refused upload names the frame and the part that is wrong."""


def test_first_100_faults_of_an_annotation_are_listed_others_counted(api):
    dataset, count = api.dataset(), 400_000
    kept = b'{"boxes": [], "kept": [' + b"1e999," * (count - 1) + b"1e999]}"

    response = api.put(dataset, "a", kept)

    problem = response.json()
    assert (response.status_code, problem["code"]) == (422, "bad_annotation")
    assert (len(problem["errors"]), problem["more_errors"]) == (100, count - 100)
    assert problem["errors"][99]["pointer"] == "/kept/99"
    assert problem["detail"].endswith(f" (and {count - 1} more)")
    (noted,) = api.json(f"/datasets/{dataset}/problems")["items"]
    assert noted["error"]["errors"] == problem["errors"]
    assert noted["error"]["more_errors"] == problem["more_errors"]


def test_first_100_faults_of_a_json_body_are_listed_others_counted(api):
    body = {"name": "many", **{f"key{number}": 1 for number in range(1000)}}

    problem = api.post("/datasets", body).json()

    assert problem["code"] == "invalid_request"
    assert (len(problem["errors"]), problem["more_errors"]) == (100, 900)
    assert problem["detail"].endswith(" (and 999 more)")
