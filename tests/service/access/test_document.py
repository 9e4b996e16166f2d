"""Answers of a server with a store and keys fit the OpenAPI document: with a key, without one, and with a wrong one."""

import json

import pytest
import schemathesis
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from schemathesis.config import SchemathesisConfig

from tests.service.access.conftest import bearer
from tests.service.http.test_openapi import ADVERBS, OPERATIONS, VALID, known_names
from tools import openapi

OPEN = {"/livez", "/readyz", "/v2/health/live", "/v2/health/ready"}

_CONFIG = SchemathesisConfig.from_dict(
    {
        # Names, versions and keys cannot be known from the document, so what fits the schema may still be refused.
        "checks": {
            "positive_data_acceptance": {"expected-statuses": ["2xx", "4xx"]},
            "negative_data_rejection": {"expected-statuses": ["4xx", "5xx"]},  # 413: a list beyond its bound is long
        }
    }
)


@pytest.fixture(scope="module")
def api():
    return schemathesis.openapi.from_dict(json.loads(openapi.FILE.read_text(encoding="utf-8")), config=_CONFIG)


@pytest.mark.parametrize("key", ["admin", None, "revoked"])
@pytest.mark.parametrize(("path", "method", "mode"), OPERATIONS)
def test_answers_fit_the_document(api, guarded, path, method, mode, key):
    headers = {} if key is None else bearer(guarded.keys[key])
    base = f"http://127.0.0.1:{guarded.server.port}"
    answers = []

    @given(case=api[path][method].as_strategy(generation_mode=mode), verb=st.sampled_from(["reach", "arm3", "nope"]))
    @settings(max_examples=8, deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck))
    def check(case, verb):
        if "verb" in case.path_parameters:
            case.path_parameters["verb"] = verb
            if mode is VALID and verb in ADVERBS:
                case.body = known_names(case.body, ADVERBS[verb])
        case.headers.pop("Authorization", None)
        answers.append(case.call_and_validate(base_url=base, headers=headers))

    check()
    refused = {answer.status_code for answer in answers if answer.status_code in (401, 403)}
    assert refused == (set() if key == "admin" or path in OPEN else {401})
