# SPDX-License-Identifier: BSD-3-Clause
"""The reference has every public name."""

import importlib

import pytest
from public_names import WITHOUT_PAGE, _packages, public_names
from stage_pages import api_pages

import epi360

NAMES = [one for page in public_names().values() for one in page]


def test_what_import_epi360_offers_is_explained():
    explained = {one.called for one in NAMES} | set(public_names())
    assert {f"epi360.{name}" for name in epi360.__all__} <= explained


@pytest.mark.parametrize("package", _packages())
def test_what_a_package_exports_is_on_its_page_or_that_of_epi360(package):
    exported = importlib.import_module(package).__all__
    explained = {one.name for one in public_names()[package]}
    at_top = {name for name in exported if f"epi360.{name}" in {one.called for one in NAMES}}
    assert exported
    assert set(exported) <= explained | at_top


def test_packages_without_a_page_export_nothing_more():
    for package in WITHOUT_PAGE - {"epi360.cli"}:
        parent = importlib.import_module(package.rpartition(".")[0])
        assert set(importlib.import_module(package).__all__) <= set(parent.__all__)


def test_each_name_can_be_imported_as_it_is_called():
    for one in NAMES:
        home, _, name = one.called.rpartition(".")
        assert hasattr(importlib.import_module(home), name), one.called


def test_functions_and_classes_have_a_summary():
    for one in NAMES:
        value = getattr(importlib.import_module(one.package), one.name)
        if one.name[0].isupper() and isinstance(value, type) or hasattr(value, "__code__"):
            assert one.summary.endswith((".", ":")), one.called


def test_each_name_is_explained_once():
    text = "\n".join(api_pages().values())
    for one in NAMES:
        assert text.count(f"::: {one.called}\n") == 1, one.called
