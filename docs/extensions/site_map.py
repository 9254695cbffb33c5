"""The order of the pages: which page lists which below it."""

CONTENTS: dict[str, dict[str, tuple[str, ...]]] = {
    "index": {
        "Start": ("install", "tutorials/index", "howto/index", "gallery/index", "pictures"),
        "Understand": (
            "architecture",
            "conventions",
            "sensor",
            "trocar",
            "physics",
            "time",
            "depth",
            "seeing",
            "reality",
        ),
        "Reference": (
            "tasks/README",
            "environments",
            "wrappers",
            "vector",
            "learning",
            "baselines",
            "reference/tasks",
            "reference/commands",
            "reference/configuration",
            "reference/index",
        ),
        "Evidence": ("results/README", "studies/README", "bench", "comparison"),
        "Project": ("limits", "cite"),
    },
    "tutorials/index": {
        "": (
            "tutorials/first_loop",
            "tutorials/own_controller",
            "tutorials/own_estimator",
            "tutorials/own_phantom",
            "tutorials/latency_study",
            "tutorials/train_network",
            "tutorials/train_policy",
        ),
    },
    "howto/index": {"": ("own_images", "howto/calibrate_bench", "howto/change_theatre", "howto/cluster")},
    "tasks/README": {"": ("tasks/reach", "tasks/track", "tasks/palpate", "tasks/scan", "tasks/look")},
    "studies/README": {
        "": ("studies/latency", "studies/delay-margin", "studies/error-budget", "studies/pattern", "studies/own"),
    },
    "reference/index": {
        "": ("reference/assets", "reference/perception", "reference/control", "reference/envs", "reference/studies"),
    },
}


def contents_markdown(docname: str) -> str:
    """Return the tables of contents of a page, which the site shows at its side."""
    return "\n\n".join(_toctree(caption, pages) for caption, pages in CONTENTS[docname].items())


def _toctree(caption: str, pages: tuple[str, ...]) -> str:
    options = [":hidden:", ":titlesonly:", *([f":caption: {caption}"] if caption else [])]
    return "\n".join(["```{toctree}", *options, "", *(f"/{page}" for page in pages), "```"])
