// Frames of texels: tangent and bitangent of normals, turned by rotations (`Distribution._make_frame`), and the gradients of both.

// A vector of two or three brought to length 1, and what divides its gradients; zero stays zero, and so do its gradients.
typedef struct {
    REAL x, y, z, largest, length, there;
} NAME(Unit);

static inline NAME(Unit) NAME(unit)(REAL x, REAL y, REAL z) {
    const REAL a = ABSOLUTE(x), b = ABSOLUTE(y), c = ABSOLUTE(z);
    REAL largest = a <= b ? b : a;
    largest = largest <= c ? c : largest;
    const REAL there = largest < TINY ? 0 : 1;
    largest = largest < TINY ? 1 : largest;
    x /= largest, y /= largest, z /= largest;
    const REAL squared = x * x + y * y + z * z, length = SQRT(squared < TINY ? 1 : squared), scale = there / length;
    const NAME(Unit) found = {x * scale, y * scale, z * scale, largest, length, there};
    return found;
}

// The gradient of what was brought to length 1.
static inline void NAME(pull_unit)(const NAME(Unit) *unit, REAL *x, REAL *y, REAL *z) {
    const REAL along = unit->x * *x + unit->y * *y + unit->z * *z, length = unit->length, largest = unit->largest;
    *x = unit->there * ((*x - unit->x * along) / length) / largest;
    *y = unit->there * ((*y - unit->y * along) / length) / largest;
    *z = unit->there * ((*z - unit->z * along) / length) / largest;
}

// The frame [xyz, tangent bitangent normal, texels] of a normal [3, texels] and a rotation [2, texels]; NULL is +z and no turn.
void NAME(frames)(const REAL *normal, const REAL *rotation, int64_t texels, REAL *restrict frame, int64_t threads) {
    const int64_t t = texels;
#pragma omp parallel for simd num_threads((int)threads) schedule(static)
    for (int64_t i = 0; i < t; i++) {
        const NAME(Unit) n = normal ? NAME(unit)(normal[i], normal[t + i], normal[2 * t + i]) : NAME(unit)(0, 0, 1);
        const NAME(Unit) turn = rotation ? NAME(unit)(rotation[i], rotation[t + i], 0) : NAME(unit)(1, 0, 0);
        const REAL below = 1 + n.z, shared = ABSOLUTE(below) < TINY ? 0 : 1 / (ABSOLUTE(below) < TINY ? 1 : below);
        const REAL tx = 1 - n.x * n.x * shared, both = -n.x * n.y * shared, by = 1 - n.y * n.y * shared;
        const REAL cosine = turn.x, sine = turn.y;
        frame[i] = cosine * tx + sine * both, frame[t + i] = cosine * both - sine * tx, frame[2 * t + i] = n.x;
        frame[3 * t + i] = cosine * both + sine * by, frame[4 * t + i] = cosine * by - sine * both, frame[5 * t + i] = n.y;
        frame[6 * t + i] = -cosine * n.x - sine * n.y, frame[7 * t + i] = sine * n.x - cosine * n.y, frame[8 * t + i] = n.z;
    }
}

// The gradients of normal and rotation, each NULL where it is not there, for that of the frame, `above`.
void NAME(frames_gradients)(
    const REAL *normal, const REAL *rotation, int64_t texels, const REAL *above, REAL *restrict of_normal, REAL *restrict of_rotation,
    int64_t threads
) {
    const int64_t t = texels;
#pragma omp parallel for simd num_threads((int)threads) schedule(static)
    for (int64_t i = 0; i < t; i++) {
        const NAME(Unit) n = normal ? NAME(unit)(normal[i], normal[t + i], normal[2 * t + i]) : NAME(unit)(0, 0, 1);
        const NAME(Unit) turn = rotation ? NAME(unit)(rotation[i], rotation[t + i], 0) : NAME(unit)(1, 0, 0);
        const REAL below = 1 + n.z, open = ABSOLUTE(below) < TINY ? 0 : 1, shared = open / (open == 0 ? 1 : below);
        const REAL tx = 1 - n.x * n.x * shared, both = -n.x * n.y * shared, by = 1 - n.y * n.y * shared;
        const REAL *a = above + i;
        if (of_rotation) {
            // The tangent (tx, both, -x), the bitangent (both, by, -y), before they are turned.
            const REAL ux = a[0], uy = a[3 * t], uz = a[6 * t], vx = a[t], vy = a[4 * t], vz = a[7 * t];
            REAL of_cosine = ux * tx + uy * both - uz * n.x + vx * both + vy * by - vz * n.y;
            REAL of_sine = ux * both + uy * by - uz * n.y - vx * tx - vy * both + vz * n.x, none = 0;
            NAME(pull_unit)(&turn, &of_cosine, &of_sine, &none);
            of_rotation[i] = of_cosine, of_rotation[t + i] = of_sine;
        }
        if (of_normal) {
            const REAL c = turn.x, s = turn.y;
            const REAL gtx = c * a[0] - s * a[t], gty = c * a[3 * t] - s * a[4 * t], gtz = c * a[6 * t] - s * a[7 * t];
            const REAL gbx = s * a[0] + c * a[t], gby = s * a[3 * t] + c * a[4 * t], gbz = s * a[6 * t] + c * a[7 * t];
            const REAL mixed = gty + gbx;
            const REAL of_shared = -gtx * n.x * n.x - mixed * n.x * n.y - gby * n.y * n.y;
            REAL x = a[2 * t] - 2 * gtx * n.x * shared - mixed * n.y * shared - gtz;
            REAL y = a[5 * t] - 2 * gby * n.y * shared - mixed * n.x * shared - gbz;
            REAL z = a[8 * t] - of_shared * shared * shared;
            NAME(pull_unit)(&n, &x, &y, &z);
            of_normal[i] = x, of_normal[t + i] = y, of_normal[2 * t + i] = z;
        }
    }
}

// Unit normals [pictures, 3, texels] of slopes [pictures, 2, texels], and the gradient of the slopes for theirs.
void NAME(normals)(const REAL *slopes, int64_t pictures, int64_t texels, REAL *restrict normals, int64_t threads) {
    for (int64_t picture = 0; picture < pictures; picture++) {
        const REAL *across = slopes + 2 * picture * texels, *up = across + texels;
        REAL *restrict x = normals + 3 * picture * texels, *restrict y = x + texels, *restrict z = y + texels;
#pragma omp parallel for simd num_threads((int)threads) schedule(static)
        for (int64_t i = 0; i < texels; i++) {
            const NAME(Unit) n = NAME(unit)(-across[i], -up[i], 1);
            x[i] = n.x, y[i] = n.y, z[i] = n.z;
        }
    }
}

void NAME(normals_gradients)(
    const REAL *slopes, int64_t pictures, int64_t texels, const REAL *above, REAL *restrict of, int64_t threads
) {
    for (int64_t picture = 0; picture < pictures; picture++) {
        const REAL *across = slopes + 2 * picture * texels, *up = across + texels;
        const REAL *of_x = above + 3 * picture * texels, *of_y = of_x + texels, *of_z = of_y + texels;
        REAL *restrict to_across = of + 2 * picture * texels, *restrict to_up = to_across + texels;
#pragma omp parallel for simd num_threads((int)threads) schedule(static)
        for (int64_t i = 0; i < texels; i++) {
            const NAME(Unit) n = NAME(unit)(-across[i], -up[i], 1);
            REAL x = of_x[i], y = of_y[i], z = of_z[i];
            NAME(pull_unit)(&n, &x, &y, &z);
            to_across[i] = -x, to_up[i] = -y;
        }
    }
}
