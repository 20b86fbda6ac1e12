"""The page's modules in two scripts."""

import re

import pytest

from app.http.packs import in_order, packs_of
from app.package import static_dir

VIEWS = ["datasets/home", "queue/queue", "grid/grid", "review/frame"]


@pytest.fixture
def page(tmp_path):
    """A page of small modules; returns a function that writes one more."""

    def write(name: str, text: str) -> None:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)

    for view in VIEWS:
        write(f"js/{view}.js", "export const view = 1;\n")
    write("vendor/lib.js", "var n=1;export{n as one,n as default};")
    write(
        "js/core/a.js",
        "// note\nexport const a = 1;\n/** why */\nexport function f() {}\n",
    )
    write(
        "js/main.js",
        'import lib from "../vendor/lib.js";\n'
        'import { a as first,\n  f,\n} from "./core/a.js";\nawait f(lib, first);\n',
    )
    return write


def test_modules_are_functions_in_the_order_of_their_imports(page, tmp_path):
    first = packs_of(tmp_path)["first.js"].decode()

    names = re.findall(r"^const (\$\d+) = .*// (.+)$", first, re.MULTILINE)
    of = {name: number for number, name in names}
    assert [name for _, name in names][-3:] == [
        "vendor/lib.js",
        "js/core/a.js",
        "js/main.js",
    ]
    assert f"const {{ default: lib }} = {of['vendor/lib.js']};" in first
    assert f"const {{ a: first, f }} = {of['js/core/a.js']};" in first
    assert "return { one: n, default: n };" in first
    assert "const a = 1;\nfunction f() {}\nreturn { a, f };" in first
    assert f"const {of['js/main.js']} = await (async () => {{" in first


def test_module_that_is_awaited_is_in_the_second_script(page, tmp_path):
    page("js/core/later.js", 'import { a } from "./a.js";\nexport const b = a;\n')
    page(
        "js/core/a.js", 'export const a = async () => (await import("./later.js")).b;\n'
    )
    page("js/main.js", 'import { a } from "./core/a.js";\nawait a();\n')

    first, later = (text.decode() for text in packs_of(tmp_path).values())

    (shared,) = re.findall(r"^const (\$\d+) = .*// js/core/a.js$", first, re.MULTILINE)
    (number,) = re.findall(r"^const (\$\d+) = .*later.js$", later, re.MULTILINE)
    assert f'((await import("./later.js")).{number}).b' in first
    assert f"export {{ {shared} }};" in first
    assert later.startswith(f'import {{ {shared} }} from "./first.js";\n')
    assert later.endswith(f"export {{ {number} }};\n")


@pytest.mark.parametrize(
    "text",
    [
        'import * as a from "./core/a.js";',
        "export let a = 1;",
        "export * from './b.js';",
    ],
)
def test_module_of_another_form_is_refused(page, tmp_path, text):
    page("js/queue/queue.js", text)

    with pytest.raises(ValueError, match=r"js/queue/queue\.js imports or exports"):
        packs_of(tmp_path)


def test_modules_that_import_each_other_are_refused():
    with pytest.raises(ValueError, match=r"a\.js imports itself by way of b\.js"):
        in_order({"a.js": ["b.js"], "b.js": ["a.js"]}, ["a.js"])


def test_packs_of_the_page_have_no_import_of_a_module():
    for text in packs_of(static_dir()).values():
        assert set(re.findall(r"^import .* from \"(.*)\"", text.decode(), re.M)) <= {
            "./first.js"
        }
