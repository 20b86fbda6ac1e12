"""Exports have the same bytes whether files are stored in a bucket or in a folder."""

from app.db.tables import Export
from app.exports.service import request_export
from app.jobs.queries import job_with_id
from tests.support import frames as scene
from tests.support.services import ANSWERED_AT, ServiceDataset, running_services
from tests.support.waiting import until
from unghost.wire.runs import ExportIn

FORMATS = {
    "yolo": {"images": "copy"},
    "coco": {},
    "manifest": {},
    "decisions-jsonl": {},
}


def exports(folder, name, **chosen):
    """Fill a new service, and give the digest of its export in each format."""
    with running_services(folder, **chosen) as services:
        street = rename_dataset(services, name)
        for number in range(3):
            files = {"image": scene.image(number), "segmentation": scene.segmentation()}
            street.put(f"{number}", scene.annotation(), **files)
        street.review(street.box_ids()[0], "reject", at=ANSWERED_AT)
        return {form: export_state_and_digest(street, form) for form in FORMATS}


def rename_dataset(services, name) -> ServiceDataset:
    made = services.dataset()
    with services.context.database.write() as session:
        made.row(session).name = name
    return ServiceDataset(services, name, made.id)


def export_state_and_digest(street, form):
    request = ExportIn(format=form, options=FORMATS[form])
    with street.context.database.write() as session:
        export_id = request_export(
            street.context, session, street.row(session), request, "ada"
        ).id

    def ended():
        with street.context.database.read() as session:
            export = job_with_id(session, Export, export_id)
        is_over = export.state not in ("queued", "running")
        return (export.state, export.sha256) if is_over else None

    return until(ended, "the export does not end")


def test_exports_have_the_same_bytes_from_a_bucket_and_a_folder(tmp_path, s3):
    in_folder = exports(tmp_path / "folder", "street")
    in_bucket = exports(tmp_path / "bucket", "street", **s3.bucket().settings)

    assert in_bucket == in_folder
    assert {state for state, _ in in_folder.values()} == {"done"}
