from tools import mapping_table


def test_the_tables_of_the_client_are_those_of_the_library():
    assert mapping_table.FILE.read_text(encoding="utf-8") == mapping_table.table(), "run make generate"


def test_names_of_rigs_that_the_client_compares_with_are_those_of_the_library():
    assert mapping_table.VECTORS.read_text(encoding="utf-8") == mapping_table.vectors(), "run make generate"
