"""Fits of the factorisations: randomised truncated SVD over streamed images, and k-means in subspace distance."""

from __future__ import annotations

import math
import warnings

import torch
from torch import Tensor

from torchmat.fitting.models.image_matrix import OVERSAMPLING, ImageMatrix, leading, range_finder, require_at_most
from torchmat.fitting.recipe import Recipe, Tiling
from torchmat.fitting.shared import Shared
from torchmat.fitting.training import Fitted, Training
from torchmat.models import LocalPca, Pca
from torchmat.models.angular import projected
from torchmat.repeatable import add_product, one_thread, product

_LLOYD_STEPS = 30
_RESTARTS = 2


def fit_pca(training: Training, *, components: int = 16, storage: str = "half") -> Fitted:
    """Truncated SVD of the matrix whose rows are images; not centred, as BTF compression usually is.

    Args:
        components: RGB textures, at least 1 and at most as many as there are images or numbers in one.
    """
    if training.table("weight") is not None:
        return _pca_of(training, components, storage)
    images = ImageMatrix(training)
    count = len(images.rows)
    require_at_most("components", components, min(count, 3 * images.texels))
    width = 3 * images.texels

    def times(right: Tensor) -> Tensor:
        return torch.cat([product(part.flatten(1), right) for _, part in images.runs()])

    def transposed(left: Tensor) -> Tensor:
        total = torch.zeros(width, left.shape[1], dtype=left.dtype)
        for rows, part in images.runs():
            add_product(total, part.flatten(1), left[rows])
        return total

    rank = min(components + OVERSAMPLING, count, width)
    generator = torch.Generator().manual_seed(training.seed)
    found, rest = range_finder(times, transposed, width, rank, generator, training.dtype)
    along = leading(rest, components)
    # Images are projected, not taken from the SVD: a dark texel beside a highlight of 1e6 times keeps its digits.
    maps = {
        "component": product(along.T, rest).reshape(-1, training.btf.height, training.btf.width),
        "weight": images.plain(product(found, along)).T[:, None].contiguous(),
        "directions": _directions(training, images.rows),
    }
    material = _balanced(Pca, maps, ("component", "weight"), components=components, storage=storage)
    return Fitted(material, shared=Shared({name: maps[name] for name in ("weight", "directions")}))


def _known(training: Training, names: tuple[str, ...]) -> dict[str, Tensor]:
    """Return tables that all texels share, which are known already."""
    assert training.shared is not None
    return {name: training.shared.tables[name] for name in names}


def _pca_of(training: Training, components: int, storage: str) -> Fitted:
    """Return the PCA whose weights are known already: each texel is projected onto them, in one pass."""
    maps = _known(training, ("weight", "directions"))
    images = ImageMatrix(training, keep=False)
    weight = images.weighed(maps["weight"][:, 0].T).T.double()
    with one_thread():
        ways = torch.linalg.pinv(weight).to(training.dtype)  # [sample, components]
    total = torch.zeros(components, 3 * images.texels, dtype=training.dtype)
    for rows, part in images.runs():
        add_product(total, ways[rows], part.flatten(1))
    maps["component"] = total.reshape(-1, training.btf.height, training.btf.width)
    return Fitted(Pca(maps, components=components, storage=storage))


def _thin_svd(matrix: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the SVD of a wide matrix [r, n], n >> r, by QR of its transpose."""
    with one_thread():
        q, r = torch.linalg.qr(matrix.T)
        u, singular, v = torch.linalg.svd(r.T.double())
        return u.to(matrix.dtype), singular.to(matrix.dtype), (v.to(matrix.dtype) @ q.T)


def _balanced(kind, maps: dict[str, Tensor], pair: tuple[str, str], **options) -> Pca:
    """Share the scale of each component between its texture and its table, so that a half holds both."""
    texture, table = pair
    count = options["components"]
    size = maps[table].abs().amax(dim=(1, 2)).clamp(min=1e-30).sqrt()
    maps[table] = maps[table] / size[:, None, None]
    maps[texture] = (maps[texture].unflatten(0, (count, -1)) * size[:, None, None, None]).flatten(0, 1)
    return kind(maps, **options)


def _directions(training: Training, rows: Tensor) -> Tensor:
    found = projected(training.btf.light[rows], training.btf.view[rows])
    return found.T[:, None].to(training.dtype).contiguous()


def fit_local_pca(
    training: Training, *, clusters: int = 8, components: int = 8, storage: str = "half"
) -> Fitted:
    """k-means of texels in the distance to each cluster's own subspace, then PCA per cluster (Müller et al. 2003).

    The texels' reflectance [texel, 3 sample] is first brought to its leading dimensions by a randomised SVD; all
    clustering happens there.

    Args:
        clusters: groups of texels, each with components of its own, at least 1 and at most as many as texels.
        components: weights a texel, at least 1 and at most as many as the smaller of texels and values of one.
    """
    if training.table("reflectance") is not None:
        return _local_pca_of(training, clusters, components, storage)
    images = ImageMatrix(training)
    count = len(images.rows)
    require_at_most("clusters", clusters, images.texels)
    require_at_most("components", components, min(images.texels, 3 * count))

    def times(right: Tensor) -> Tensor:  # right [3 sample, r] -> [texel, r]
        total = torch.zeros(images.texels, right.shape[1], dtype=right.dtype)
        right = right.unflatten(0, (count, 3))
        for rows, part in images.runs():
            add_product(total, part.flatten(0, 1), right[rows].flatten(0, 1))
        return total

    def transposed(left: Tensor) -> Tensor:  # left [texel, r] -> [3 sample, r]
        return torch.cat([product(part.flatten(0, 1), left) for _, part in images.runs()])

    generator = torch.Generator().manual_seed(training.seed)
    rank = min(max(4 * (components + 1), 96), images.texels, 3 * count)
    found, rest = range_finder(times, transposed, 3 * count, rank, generator, training.dtype)
    left, singular, right = _thin_svd(rest)
    points = (product(found, left) * singular).double()
    known = training.btf.inside
    label = torch.zeros(images.texels, dtype=torch.long)  # off the object all texels are 0, and would be a cluster
    label[known], means, bases = _cluster(points[known], clusters, components, generator)
    weight = torch.zeros(components, images.texels, dtype=torch.float64)
    for number in range(clusters):
        inside = label == number
        weight[:, inside] = bases[number] @ (points[inside] - means[number]).T
    tables = torch.cat((means[:, None], bases), dim=1).to(training.dtype)
    tables = product(tables, right)  # [clusters, 1 + components, 3 sample]
    tables = images.plain(tables.unflatten(2, (count, 3)).permute(2, 0, 1, 3)).permute(2, 3, 1, 0).flatten(0, 1)
    size = (training.btf.height, training.btf.width)
    maps = {
        "cluster": label.reshape(1, *size).to(training.dtype), "weight": weight.reshape(-1, *size).to(training.dtype),
        "reflectance": tables.contiguous(), "directions": _directions(training, images.rows),
    }
    material = LocalPca(maps, clusters=clusters, components=components, storage=storage)
    return Fitted(material, shared=Shared({name: maps[name] for name in ("reflectance", "directions")}))


def _local_pca_of(training: Training, clusters: int, components: int, storage: str) -> Fitted:
    """Return the local PCA whose tables are known already: each texel takes the nearest cluster's, in one pass."""
    maps = _known(training, ("reflectance", "directions"))
    images = ImageMatrix(training, keep=False)
    table = images.weighed(maps["reflectance"].permute(2, 0, 1)).unflatten(1, (1 + components, 3))
    table = table.permute(3, 1, 0, 2)  # cluster, row, sample, colour
    rows_of_tables = table.flatten(0, 1)
    total = torch.zeros(len(rows_of_tables), images.texels, dtype=training.dtype)
    for rows, part in images.runs():
        add_product(total, rows_of_tables[:, rows].flatten(1).T, part.flatten(0, 1))
    along = total.double().unflatten(0, (clusters, 1 + components))
    flat = table.flatten(2).double()
    mean, basis = flat[:, :1], flat[:, 1:]
    # The distance to each cluster's subspace, without what is the same for all clusters.
    weight = along[:, 1:] - (basis @ mean.transpose(1, 2))
    distance = mean.square().sum(dim=2) - 2 * along[:, 0] - weight.square().sum(dim=1)
    label = distance.argmin(dim=0)
    size = (training.btf.height, training.btf.width)
    chosen = weight.gather(0, label.expand(1, components, -1))[0]
    maps |= {
        "cluster": label.reshape(1, *size).to(training.dtype), "weight": chosen.reshape(-1, *size).to(training.dtype),
    }
    return Fitted(LocalPca(maps, clusters=clusters, components=components, storage=storage))


def _subspace(points: Tensor, components: int) -> tuple[Tensor, Tensor]:
    """Return mean [d] and leading directions [components, d] of points [n, d]; missing directions are zero rows."""
    mean = points.mean(dim=0)
    centred = points - mean
    gram = product(centred.T, centred)
    with one_thread():
        values, vectors = torch.linalg.eigh(gram)
    basis = vectors.T.flip(0)[:components]
    known = values.flip(0)[:components] > values.max().clamp(min=1e-300) * 1e-12
    basis = basis * known[:, None]
    if len(basis) < components:
        basis = torch.cat((basis, basis.new_zeros(components - len(basis), basis.shape[1])))
    return mean, basis


def _distance(points: Tensor, mean: Tensor, basis: Tensor) -> Tensor:
    centred = points - mean
    return centred.square().sum(dim=1) - (centred @ basis.T).square().sum(dim=1)


def _cluster(
    points: Tensor, clusters: int, components: int, generator: torch.Generator
) -> tuple[Tensor, Tensor, Tensor]:
    """Return labels [texel], means [clusters, d] and bases [clusters, components, d] of the best of a few runs.

    The first labels come from k-means of the points themselves; then texels move to the cluster whose subspace
    reconstructs them best, until none moves.
    """
    least, best = math.inf, None
    for _ in range(_RESTARTS):
        seed = int(torch.randint(2**31 - 1, (1,), generator=generator))
        label = _first_labels(points[:, : min(16, points.shape[1])], clusters, seed)
        label, error, means, bases = _lloyd(points, label, clusters, components)
        if best is None or error < least:
            least, best = error, (label, means, bases)
    assert best is not None
    return best


def _first_labels(points: Tensor, clusters: int, seed: int) -> Tensor:
    from sklearn.cluster import KMeans
    from sklearn.exceptions import ConvergenceWarning
    from threadpoolctl import threadpool_limits  # comes with scikit-learn

    # Threads of k-means add their sums in the order in which they finish.
    with threadpool_limits(1, user_api="openmp"), warnings.catch_warnings():
        # Fewer different texels than clusters: some clusters stay empty, and `_lloyd` gives them all texels.
        warnings.simplefilter("ignore", ConvergenceWarning)
        return torch.from_numpy(KMeans(clusters, n_init=1, random_state=seed).fit(points.numpy()).labels_).long()


def _lloyd(points: Tensor, label: Tensor, clusters: int, components: int) -> tuple[Tensor, float, Tensor, Tensor]:
    for _ in range(_LLOYD_STEPS):
        spaces = []
        for number in range(clusters):
            inside = points[label == number]
            spaces.append(_subspace(inside if len(inside) else points, components))
        means = torch.stack([mean for mean, _ in spaces])
        bases = torch.stack([basis for _, basis in spaces])
        distance = torch.stack([_distance(points, mean, basis) for mean, basis in spaces])
        nearest = distance.argmin(dim=0)
        if bool((nearest == label).all()):
            break
        label = nearest
    return label, float(distance.gather(0, label[None]).sum()), means, bases


# Their tables hold a number for each measured sample: a start that has them all is a factorisation, the answer itself.
# Images that are few are decoded once and kept.
PCA = Recipe(
    Pca, fit_pca, near="centred", bytes_per_texel="96", descends=False, compared=("components=8", "components=16"),
    tiling=Tiling(kept_mb=260.0),
)
LOCAL_PCA = Recipe(LocalPca, fit_local_pca, near="centred", bytes_per_texel="17", descends=False, tiling=Tiling(kept_mb=260.0))
