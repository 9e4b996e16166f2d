"""Settings: documented, bounded, arguments before environment before defaults."""

import pytest
from pydantic import ValidationError

from service.settings import Settings
from tools import settings_table


def test_the_committed_table_is_the_code_s():
    assert settings_table.FILE.read_text(encoding="utf-8") == settings_table.text(), "run `make generate`"


@pytest.mark.parametrize("name", Settings.model_fields)
def test_each_setting_has_a_description(name):
    assert Settings.model_fields[name].description


def test_arguments_win_over_the_environment(monkeypatch):
    monkeypatch.setenv("ADVERB_PORT", "9000")
    monkeypatch.setenv("ADVERB_ALLOW_PUBLIC", "yes")
    assert Settings().port == 9000
    assert Settings().allow_public
    assert Settings(port=9001).port == 9001


def test_an_empty_variable_is_no_setting(monkeypatch):
    monkeypatch.setenv("ADVERB_DATA", "")
    assert Settings().data is None


@pytest.mark.parametrize(("name", "value"), [("port", 70_000), ("max_batch", 0), ("log_level", "loud"), ("port", "x")])
def test_settings_out_of_bounds_are_refused(name, value):
    with pytest.raises(ValidationError, match=name):
        Settings(**{name: value})
