from core.text import count_of


def test_a_count_of_one_has_its_noun_in_the_singular():
    assert count_of(1, "scan") == "1 scan"
    assert count_of(1, "query", "queries") == "1 query"


def test_any_other_count_has_the_plural():
    assert [count_of(count, "scan") for count in (0, 2, 1000)] == [
        "0 scans",
        "2 scans",
        "1000 scans",
    ]
    assert count_of(0, "query", "queries") == "0 queries"
