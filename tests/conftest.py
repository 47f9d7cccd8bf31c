"""Options of the whole test run."""


def pytest_addoption(parser):
    parser.addoption(
        "--d435-recording",
        default="",
        help="a real D435's recording (.bag of the SDK)",
    )
