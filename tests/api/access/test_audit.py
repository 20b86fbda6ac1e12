"""The audit log: who did what, when and to what; entries are never changed."""

import pytest
from sqlalchemy.exc import DBAPIError

from app.access.audit import MOST_AN_HOUR
from tests.support.databases import change
from tests.support.live import block_jobs

TOKENS = "/api/v1/tokens"
DATASETS = "/api/v1/datasets"
AUDIT = "/api/v1/audit"


def entries(client, subject):
    """The entries of the audit log about one subject, oldest first."""
    items = client.get(AUDIT, params={"limit": 1000}).json()["items"]
    return [entry for entry in reversed(items) if entry["subject"] == subject]


def actions(client, subject):
    return [entry["action"] for entry in entries(client, subject)]


def create_token(client, name, role="admin"):
    response = client.post(TOKENS, json={"name": name, "role": role})
    assert response.status_code == 201
    return response.json()


def client_with_token(service, token):
    return service.client(Authorization=f"Bearer {token['token']}")


def test_first_token_is_logged_as_created_by_the_service(admin):
    first = entries(admin, "admin")[0]

    assert (first["actor"], first["token_id"]) == ("unghost", None)
    assert first["action"] == "token.created"
    assert first["details"] == {"token_id": 1, "role": "admin"}


@pytest.mark.parametrize("action", ["login_code.created", "session.opened"])
def test_logins_of_one_token_are_limited_in_the_log_and_others_are_not(
    service, admin, action
):
    """A viewer could fill the disk with entries, which nothing deletes."""

    def log_in(token):
        with client_with_token(service, token) as client:
            if action == "login_code.created":
                return client.post("/api/v1/login-codes").status_code
            sent = {"token": token["token"]}
            session = client.post("/api/v1/session", json=sent).json()["session"]
            ended = client.delete(
                "/api/v1/session", headers={"Authorization": f"Bearer {session}"}
            )
            return ended.status_code

    def noted(token):
        items = admin.get(AUDIT, params={"limit": 1000}).json()["items"]
        of_token = [entry for entry in items if entry["token_id"] == token["id"]]
        return sum(entry["action"] == action for entry in of_token)

    busy, calm = (create_token(admin, f"{who}-{action}") for who in ("busy", "calm"))
    statuses = {log_in(busy) for _ in range(MOST_AN_HOUR + 5)}
    log_in(calm)

    assert statuses <= {201, 204}
    assert (noted(busy), noted(calm)) == (MOST_AN_HOUR, 1)


def test_audit_entries_of_a_revoked_token_are_kept(service, admin):
    token = create_token(admin, "grace")
    with client_with_token(service, token) as grace:
        assert grace.post(DATASETS, json={"name": "graces"}).status_code == 201
    for _ in range(2):
        assert admin.delete(f"{TOKENS}/{token['id']}").status_code == 204

    (made,) = entries(admin, "graces")
    assert (made["actor"], made["token_id"]) == ("grace", token["id"])
    assert token["token"] not in admin.get(AUDIT).text
    assert actions(admin, "grace") == ["token.created", "token.revoked"]


def test_dataset_is_audited_from_creation_to_deletion(admin):
    path = f"{DATASETS}/followed"
    admin.post(DATASETS, json={"name": "followed"})
    admin.patch(path, json={"description": "d"})
    digest = admin.get(f"{path}/config").json()["digest"]
    admin.put(f"{path}/config", json={"digest": digest})
    admin.post(f"{path}/runs", json={"config": digest, "activate": True})
    admin.post(f"{path}/runs", json={"config": digest, "activate": False})
    admin.delete(path, params={"confirm": "followed"})

    assert actions(admin, "followed") == [
        "dataset.created",
        "dataset.changed",
        "config.activated",
        "config.activated",
        "dataset.deleted",
    ]
    _, changed, activated, *_ = entries(admin, "followed")
    assert changed["details"] == {"changed": ["description"], "run": None}
    assert activated["details"]["config"] == digest


def test_cancelled_jobs_are_audited_with_their_dataset(service, admin):
    admin.post(DATASETS, json={"name": "stopped"})
    digest = admin.get(f"{DATASETS}/stopped/config").json()["digest"]
    with block_jobs(service.app.state.services.engine):
        export = admin.post(f"{DATASETS}/stopped/exports", json={"format": "yolo"})
        run = admin.post(f"{DATASETS}/stopped/runs", json={"config": digest})
        for job in (export, run):
            response = admin.post(f"{job.headers['location']}/cancel")
            assert response.status_code == 202

    items = admin.get(AUDIT, params={"limit": 2}).json()["items"]
    assert [(entry["action"], entry["subject"]) for entry in items] == [
        ("run.cancelled", str(run.json()["id"])),
        ("export.cancelled", str(export.json()["id"])),
    ]
    assert {entry["details"]["dataset"] for entry in items} == {"stopped"}


def test_refused_request_has_no_audit_entry(admin):
    admin.post(DATASETS, json={"name": "kept"})

    refused = [
        admin.post(DATASETS, json={"name": "kept"}),
        admin.delete(f"{DATASETS}/kept"),
        admin.put(f"{DATASETS}/kept/config", json={"digest": "0" * 64}),
        admin.post(TOKENS, json={"name": "admin"}),
    ]

    assert {response.status_code for response in refused} == {400, 404, 409}
    assert actions(admin, "kept") == ["dataset.created"]


def test_audit_pagination_lists_entries_newest_first(admin):
    for name in ("page-a", "page-b", "page-c"):
        create_token(admin, name, "viewer")

    first = admin.get(AUDIT, params={"limit": 2})
    second = admin.get(first.headers["link"].partition(">")[0].lstrip("<"))

    ids = [entry["id"] for page in (first, second) for entry in page.json()["items"]]
    assert len(ids) == 4
    assert ids == sorted(ids, reverse=True)


def test_audit_log_is_append_only_in_the_database(service, admin):
    before = admin.get(AUDIT).text

    for statement in ("update audit_log set actor = 'x'", "delete from audit_log"):
        with pytest.raises(DBAPIError, match="only added to"):
            change(service.settings.data, statement)

    assert admin.get(AUDIT).text == before


def test_created_exports_are_audited(service, admin):
    admin.post(DATASETS, json={"name": "exported"})
    with client_with_token(service, create_token(admin, "joan", "reviewer")) as client:
        export = client.post(f"{DATASETS}/exported/exports", json={"format": "yolo"})

    entry = admin.get(AUDIT).json()["items"][0]
    assert (entry["actor"], entry["action"]) == ("joan", "export.created")
    assert entry["subject"] == str(export.json()["id"])
    assert entry["details"] == {"dataset": "exported", "format": "yolo"}
