"""Certificates as HDF5 files, format `climbplan/certificate`: one group a row.

The numbers of the problem (`problem/`), the tree that proves its bound (`proof/`), and the answer
x (n) with assignment (C). Sparse matrices are groups of row, column and value. The file says
everything that `climbplan verify` needs; with the statement (--problem) it is compared with that.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast, get_args

import h5py
import numpy as np
from scipy import sparse

from climbplan.certificates.certificate import Certificate
from climbplan.program.instance import Balls, Choice, Implications, Instance, Products
from climbplan.program.polytope import Polytope
from climbplan.solvers.result import Status
from climbplan.store.certified import CertifiedRow, CertifiedRows
from climbplan.store.hdf5_layout import DatasetLayout
from climbplan.store.hdf5_reading import Reader, open_store
from climbplan.store.hdf5_writing import create_store, write_dataset, write_datasets, write_text
from climbplan.store.root_attributes import read_root, require_other, write_root

FORMAT = "climbplan/certificate"
FORMAT_VERSION = 2  # of 1 the leaves were lists of integers, without products
_MOST_ROWS = 100_000

_VECTORS = {
    "q": DatasetLayout(("n",)),
    "lower": DatasetLayout(("n",), may_be_infinite=True),
    "upper": DatasetLayout(("n",), may_be_infinite=True),
    "row_lower": DatasetLayout(("m",), may_be_infinite=True),
    "row_upper": DatasetLayout(("m",), may_be_infinite=True),
    "integer": DatasetLayout(("n",), kind="bool"),
}
_IMPLIED = {
    "lower": DatasetLayout(("c",), may_be_infinite=True),
    "upper": DatasetLayout(("c",), may_be_infinite=True),
    "binary": DatasetLayout(("c",), kind="int"),
    "value": DatasetLayout(("c",), kind="bool"),
}
_BALLS = {"f": DatasetLayout(("K", "d")), "radius": DatasetLayout(("K",))}
_POLYTOPE = {
    "A": DatasetLayout(("r", "e")),
    "b": DatasetLayout(("r",), may_be_infinite=True),
    "C": DatasetLayout(("s", "e")),
    "c": DatasetLayout(("s",)),
}
_PROOF = {
    "split": DatasetLayout(("T",), kind="int"),
    "at": DatasetLayout(("T",)),
    "point": DatasetLayout(("S", "n")),
    "ball": DatasetLayout(("S", "D")),
    "empty": DatasetLayout(("S",), kind="bool"),
}
_PRODUCTS = {
    "first": DatasetLayout(("w",), kind="int"),
    "second": DatasetLayout(("w",), kind="int"),
}
_ANSWER = {"x": DatasetLayout(("n",)), "assignment": DatasetLayout(("C",), kind="int")}
_PARAMETERS = DatasetLayout(("p",))
_CENTRE = DatasetLayout(("e",))
_ENTRIES = {
    "row": DatasetLayout(("z",), kind="int"),
    "column": DatasetLayout(("z",), kind="int"),
    "value": DatasetLayout(("z",)),
}


def write_certificates(certified: CertifiedRows, path: Path) -> None:
    """Write certificates; the file appears whole or not at all. Raises UsageError if it cannot."""
    with create_store(path) as file:
        write_root(
            file,
            certified,
            FORMAT,
            FORMAT_VERSION,
            texts={"problem": certified.problem},
            numbers={"gap": certified.gap, "tolerance": certified.tolerance},
            objects={},
        )
        for k, row in enumerate(certified.rows):
            group = file.create_group(f"rows/{k:06d}")
            write_text(group, "status", row.status)
            write_dataset(group, "parameters", row.parameters, _PARAMETERS)
            if row.x is not None:
                write_datasets(group, _ANSWER, vars(row))
            _write_instance(group.create_group("problem"), row.instance)
            _write_proof(group.create_group("proof"), row.certificate)


def _write_instance(group: h5py.Group, instance: Instance) -> None:
    write_text(group, "name", instance.name)
    group.attrs["constant"] = instance.constant
    fields = vars(instance)
    write_datasets(group, _VECTORS, fields, compressed=True)
    _write_sparse(group, "P", instance.P)
    _write_sparse(group, "A", instance.A)
    products = group.create_group("products")
    write_datasets(products, _PRODUCTS, vars(instance.products), compressed=True)
    _write_sparse(group, "Q", instance.Q)
    implied = group.create_group("implications")
    _write_sparse(implied, "A", instance.implications.A)
    _write_sparse(implied, "Q", instance.implications.Q)
    write_datasets(implied, _IMPLIED, vars(instance.implications), compressed=True)
    for k, balls in enumerate(instance.balls):
        subgroup = group.create_group(f"balls/{k:06d}")
        _write_sparse(subgroup, "F", balls.F)
        write_datasets(subgroup, _BALLS, vars(balls))
        if balls.slope is not None:
            _write_sparse(subgroup, "slope", balls.slope)
    for k, choice in enumerate(instance.choices):
        subgroup = group.create_group(f"choices/{k:06d}")
        write_text(subgroup, "name", choice.name)
        _write_sparse(subgroup, "E", choice.E)
        write_dataset(subgroup, "e", choice.e, _CENTRE)
        for r, polytope in enumerate(choice.alternatives):
            alternative_group = subgroup.create_group(f"alternatives/{r:06d}")
            write_text(alternative_group, "name", polytope.name)
            write_datasets(alternative_group, _POLYTOPE, vars(polytope))


def _write_proof(group: h5py.Group, certificate: Certificate) -> None:
    group.attrs["bound"] = certificate.bound
    _write_sparse(group, "multiplier", certificate.multiplier)
    write_datasets(group, _PROOF, vars(certificate), compressed=True)


def _write_sparse(group: h5py.Group, name: str, matrix: Any) -> None:
    entries = sparse.coo_matrix(matrix)
    subgroup = group.create_group(name)
    columns = {"row": entries.row, "column": entries.col, "value": entries.data}
    for column, layout in _ENTRIES.items():
        write_dataset(subgroup, column, columns[column], layout, compressed=True)


def read_certificates(path: Path) -> CertifiedRows:
    """Return the certificates in a file, as they were written; nothing in it is ever run.

    Raises PlanFileError for another format, and for missing, misshapen or infinite numbers.
    """
    with open_store(path) as file:
        reader = Reader(path, file)
        require_other(reader, FORMAT_VERSION, FORMAT, "written by `climbplan solve --certificate`")
        members = reader.members("rows", _MOST_ROWS)
        rows = tuple(_read_row(path, file, name) for name in members)
        whole = CertifiedRows(
            **read_root(reader),
            problem=reader.text("", "problem"),
            gap=reader.number("", "gap"),
            tolerance=reader.number("", "tolerance"),
            rows=rows,
        )
        if reader.not_finite:
            raise reader.refuse(f"{reader.not_finite[0]} is not a number")
        return whole


def _read_row(path: Path, file: h5py.File, name: str) -> CertifiedRow:
    """Return one row, whose dimensions are its own."""
    reader = Reader(path, file)
    status = reader.text(name, "status")
    if status not in get_args(Status):
        raise reader.refuse(f"{name}: status {status!r}")
    parameters = reader.array(f"{name}/parameters", _PARAMETERS)
    instance = _read_instance(reader, f"{name}/problem")
    reader.dimensions["C"] = len(instance.choices)
    answer: dict[str, Any] = {"x": None, "assignment": None}
    if reader.has(f"{name}/x"):
        answer = {
            array_name: reader.array(f"{name}/{array_name}", on)
            for array_name, on in _ANSWER.items()
        }
        num_alternatives = np.array([len(choice.alternatives) for choice in instance.choices], int)
        if ((answer["assignment"] < 0) | (answer["assignment"] >= num_alternatives)).any():
            raise reader.refuse(f"{name}/assignment: no such alternative")
    certificate = _read_proof(reader, f"{name}/proof", instance)
    if reader.not_finite:
        raise reader.refuse(f"{reader.not_finite[0]} is not a number")
    return CertifiedRow(parameters, instance, certificate, cast("Status", status), **answer)


def _read_instance(reader: Reader, name: str) -> Instance:
    arrays: dict[str, Any] = {
        array_name: reader.array(f"{name}/{array_name}", on) for array_name, on in _VECTORS.items()
    }
    n, m = len(arrays["q"]), len(arrays["row_lower"])
    implications_path = f"{name}/implications"
    implied = {
        array_name: reader.array(f"{implications_path}/{array_name}", on)
        for array_name, on in _IMPLIED.items()
    }
    if ((implied["binary"] < 0) | (implied["binary"] >= n)).any():
        raise reader.refuse(f"{implications_path}/binary: no such variable")
    count = len(implied["lower"])
    factors = {
        array_name: reader.array(f"{name}/products/{array_name}", on)
        for array_name, on in _PRODUCTS.items()
    }
    products = Products(**factors)
    for array_name, columns in factors.items():
        if ((columns < 0) | (columns >= n)).any():
            raise reader.refuse(f"{name}/products/{array_name}: no such variable")
    return Instance(
        name=reader.text(name, "name"),
        constant=reader.number(name, "constant"),
        **arrays,
        P=sparse.csc_matrix(_read_sparse(reader, f"{name}/P", (n, n))),
        A=_read_sparse(reader, f"{name}/A", (m, n)),
        balls=tuple(_read_balls(reader, name, n)),
        choices=tuple(_read_choices(reader, name, n)),
        products=products,
        Q=_read_sparse(reader, f"{name}/Q", (m, products.count)),
        implications=Implications(
            A=_read_sparse(reader, f"{implications_path}/A", (count, n)),
            Q=_read_sparse(reader, f"{implications_path}/Q", (count, products.count)),
            **implied,
        ),
    )


def _iterate_members(reader: Reader, name: str) -> Iterator[str]:
    """Yield the members of a group, whose dimensions are their own; none without a group."""
    if not reader.has(name):
        return
    for member in reader.members(name, _MOST_ROWS):
        for symbol in "Kdersz":
            reader.dimensions.pop(symbol, None)
        yield member


def _read_balls(reader: Reader, name: str, n: int) -> Iterator[Balls]:
    for member in _iterate_members(reader, f"{name}/balls"):
        arrays = {
            array_name: reader.array(f"{member}/{array_name}", on)
            for array_name, on in _BALLS.items()
        }
        F = _read_sparse(reader, f"{member}/F", (arrays["f"].size, n))
        slope = None
        if "slope" in reader.root[member]:
            slope = _read_sparse(reader, f"{member}/slope", (len(arrays["radius"]), n))
        yield Balls(F=F, slope=slope, **arrays)


def _read_choices(reader: Reader, name: str, n: int) -> Iterator[Choice]:
    for member in list(_iterate_members(reader, f"{name}/choices")):
        reader.dimensions.pop("e", None)
        centre = reader.array(f"{member}/e", _CENTRE)
        E = _read_sparse(reader, f"{member}/E", (len(centre), n))
        alternatives = []
        for alternative_path in _iterate_members(reader, f"{member}/alternatives"):
            reader.dimensions["e"] = len(centre)
            arrays = {
                array_name: reader.array(f"{alternative_path}/{array_name}", on)
                for array_name, on in _POLYTOPE.items()
            }
            alternatives.append(Polytope(reader.text(alternative_path, "name"), **arrays))
        yield Choice(reader.text(member, "name"), E, centre, tuple(alternatives))


def _read_proof(reader: Reader, name: str, instance: Instance) -> Certificate:
    arrays = {
        array_name: reader.array(f"{name}/{array_name}", on) for array_name, on in _PROOF.items()
    }
    rows = len(instance.row_lower) + instance.implications.count + len(instance.choices)
    rows += sum(len(p.b) + len(p.c) for choice in instance.choices for p in choice.alternatives)
    rows += sum(balls.f.size for balls in instance.balls) + 4 * instance.products.count
    bound = float(reader.root[name].attrs.get("bound", np.nan))
    multiplier = _read_sparse(reader, f"{name}/multiplier", (len(arrays["empty"]), rows))
    return Certificate(multiplier=multiplier, bound=bound, **arrays)


def _read_sparse(reader: Reader, name: str, shape: tuple[int, int]) -> sparse.csr_matrix:
    """Return a matrix by its entries, all of which must lie in it, each once."""
    reader.dimensions.pop("z", None)
    row, column, value = (
        reader.array(f"{name}/{array_name}", on) for array_name, on in _ENTRIES.items()
    )
    inside = (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
    if not inside.all():
        raise reader.refuse(f"{name}: entries outside of {shape[0]} x {shape[1]}")
    matrix = sparse.csr_matrix((value, (row, column)), shape=shape)
    if matrix.nnz != len(value):
        raise reader.refuse(f"{name}: an entry stands twice")
    return matrix
