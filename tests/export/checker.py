"""ASAM's own checker of OpenSCENARIO files."""

from qc_baselib import Configuration, Result
from qc_openscenario import constants
from qc_openscenario.main import run_checks


def checked(path):
    """Issues that ASAM's own checker finds in a file."""
    config = Configuration()
    config.set_config_param(name="InputFile", value=str(path))
    config.register_checker_bundle(checker_bundle_name=constants.BUNDLE_NAME)
    result = Result()
    result.register_checker_bundle(
        name=constants.BUNDLE_NAME, description="", version="1", summary="", build_date="2026-01-01"
    )
    run_checks(config, result)
    count = len(result.get_checker_ids(constants.BUNDLE_NAME))
    assert count >= 15
    return [
        issue.description
        for name in result.get_checker_ids(constants.BUNDLE_NAME)
        for issue in result.get_issues(constants.BUNDLE_NAME, name)
    ]
