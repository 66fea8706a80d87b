# SPDX-License-Identifier: BSD-3-Clause
"""What a release says of itself in several files is the same in all of them."""

import re
import tomllib

import pytest
import yaml
from documents import ROOT, text_of

PROJECT = tomllib.loads(text_of(ROOT / "pyproject.toml"))
CITATION = yaml.safe_load(text_of(ROOT / "CITATION.cff"))
# conda-forge's names of what has another one there.
CONDA_NAMES = {"opencv-python-headless": "py-opencv", "matplotlib": "matplotlib-base"}


def recipe():
    # The recipe's expressions stand in ${{ }}, which YAML reads as text where they are quoted.
    text = re.sub(r"\$\{\{(.*?)\}\}", lambda found: f"<{found[1].strip()}>", text_of(
        ROOT / "packaging" / "conda-forge" / "recipe.yaml"
    ))  # fmt: skip
    return yaml.safe_load(
        text.replace('<compiler("cxx")>', "compiler").replace('<stdlib("c")>', "c")
    )


def test_version_and_licence_agree():
    project = PROJECT["project"]
    assert CITATION["version"] == project["version"] == recipe()["context"]["version"]
    assert CITATION["license"] == project["license"] == recipe()["about"]["license"]


def test_the_conda_recipe_asks_for_the_dependencies_and_floors_of_the_wheel():
    wheel = set()
    for line in PROJECT["project"]["dependencies"]:
        name, floor = re.fullmatch(r"([a-z-]+)(.*)", line).groups()
        if name.startswith("opencv"):  # the wheels of one version of OpenCV are numbered
            floor = re.fullmatch(r"(>=\d+\.\d+\.\d+)\.\d+", floor)[1]
        wheel.add(f"{CONDA_NAMES.get(name, name)} {floor}")
    assert wheel == set(recipe()["requirements"]["run"]) - {"python"} and wheel


def test_the_conda_recipe_builds_with_what_the_wheel_is_built_with():
    wheel = {line.replace("cmeel-eigen", "eigen") for line in PROJECT["build-system"]["requires"]}
    wheel = {re.sub(r"(?<=[a-z])(?=[<>=])", " ", line) for line in wheel}
    assert wheel <= set(recipe()["requirements"]["host"]) and wheel


def test_wheels_are_tested_on_every_python_that_the_project_names():
    named = [line.rpartition(" ")[2] for line in PROJECT["project"]["classifiers"]]
    versions = [version for version in named if re.fullmatch(r"3\.\d+", version)]
    built = [f"cp{version.replace('.', '')}-*" for version in versions]
    assert PROJECT["tool"]["cibuildwheel"]["build"] == built and len(built) >= 4


@pytest.mark.parametrize("line", PROJECT["project"]["dependencies"])
def test_every_dependency_has_a_floor(line):
    assert re.fullmatch(r"[a-z-]+>=[0-9.]+", line)
