"""Requests made from the OpenAPI document, both valid and invalid ones.

No answer is a 5xx, and each has a status, a type and a form that the document gives.
``make test-long`` sends hundreds of requests per route.
"""

import pytest

from tests.support.hostile.openapi_cases import (
    SCHEMA,
    check_is_not_malformed,
    restore,
    without_own_tokens,
)

pytestmark = pytest.mark.long


@SCHEMA.parametrize()
def test_every_response_to_an_admin_matches_the_openapi_document(case, api):
    bearer = {"Authorization": api.http.headers["authorization"]}
    without_own_tokens(case).call_and_validate(
        str(api.http.base_url),
        headers=bearer,
        additional_checks=[check_is_not_malformed],
    )
    if case.method == "DELETE":
        restore(api)


@SCHEMA.parametrize()
def test_requests_without_a_token_are_unauthorised_and_documented(case, api):
    response = without_own_tokens(case).call(str(api.http.base_url))

    case.validate_response(response, additional_checks=[check_is_not_malformed])
    if case.method.upper() != case.operation.method.upper():
        assert response.status_code in (401, 405), response.text  # TRACE and the like
    elif "security" in case.operation.definition.raw:
        assert response.status_code in (400, 401, 429), response.text
