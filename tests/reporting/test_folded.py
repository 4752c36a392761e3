"""What a report shows at once, and what it folds; what the script alone offers."""

import re

import pytest


@pytest.mark.slow
def test_one_figure_and_one_table_stand_before_the_sections(whole):
    begin = whole.source.split('id="measured"')[0]
    assert begin.count("<figure") == 1
    assert begin.count("<table") == 1
    assert "<details" not in begin


@pytest.mark.slow
def test_every_section_begins_with_a_conclusion_and_folds_its_tables(whole):
    for key in ("measured", "parameters", "accuracy", "factors"):
        section = whole.source.split(f'<h2 id="{key}">')[1].split("</section>")[0]
        assert section.index('class="conclusion"') < section.index("<details")
        open_part = re.sub(r"<details>.*?</details>", "", section, flags=re.S)
        assert "<table" not in open_part
        assert "<table" in section


@pytest.mark.slow
def test_buttons_come_with_the_script(whole):
    assert "<button" not in whole.source.split("<script>")[0]
    assert "CSV" in whole.page.scripts[-1]
    assert "SVG" in whole.page.scripts[-1]


@pytest.mark.slow
def test_further_figures_are_made_where_they_are_wanted(whole):
    assert 'id="figures"' not in whole.source
