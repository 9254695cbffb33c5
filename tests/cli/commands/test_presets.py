from laploop.cli.main import main


def test_presets_are_listed_by_option_with_their_sources(capsys):
    assert main(["presets"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if line.startswith("--")] == [
        *("--timing", "--optics", "--tissue-class", "--fidelity", "--actuation", "--trocar", "--motion")
    ]
    found = next(line for line in lines if line.startswith("  da-vinci-s-147 "))
    assert found.endswith("Kraus 2017)")
    assert main(["presets", "--all"]) == 2
