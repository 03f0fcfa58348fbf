// Rays that walk over a height field, one after the other: each stops where nothing that comes can change what it found.

enum { RAYS_AT_A_TIME = 512 };

// A height [rows, columns] that goes on by two texels to the right and downward, and how it goes on.
typedef struct {
    const REAL *height;
    int64_t wide;
    REAL rows, columns;
    int64_t tiles;
} NAME(Field);

// Return the surface at a place in texels, x to the right and y down, 0 at the first one's centre.
static inline REAL NAME(surface)(const NAME(Field) *field, REAL x, REAL y) {
    if (field->tiles) {
        x -= field->columns * FLOOR(x / field->columns);
        y -= field->rows * FLOOR(y / field->rows);
    } else {
        x = x < field->columns - 1 ? x : field->columns - 1;
        y = y < field->rows - 1 ? y : field->rows - 1;
    }
    x = x > 0 ? x : 0;  // not a number counts as 0, too
    y = y > 0 ? y : 0;
    const int64_t left = (int64_t)x, top = (int64_t)y;
    const REAL s = x - left, t = y - top;
    const REAL *at = field->height + top * field->wide + left, *below = at + field->wide;
    const REAL upper = at[0] + s * (at[1] - at[0]), lower = below[0] + s * (below[1] - below[0]);
    return upper + t * (lower - upper);
}

static inline REAL NAME(steps_of)(REAL across, REAL up, REAL span) {
    const REAL steps = CEIL(SQRT(across * across + up * up) * span) + 2;
    return steps < (REAL)1e7 ? steps : (steps >= (REAL)1e7 ? (REAL)1e7 : 2);
}

static inline REAL NAME(share_of)(REAL above, REAL below) {
    const REAL share = above - below == 0 ? 0 : above / (above - below);
    return share < 0 ? 0 : share > 1 ? 1 : share;
}

// Find the highest z at which the surface at uv + z slope reaches z: root [count, places].
//
// `field` is the wider height; uv [uvs, 2, places], slope [count, 2, slopes]; uvs is 1 or count, slopes 1 or places.
void NAME(first_roots)(
    const REAL *height, const REAL *uv, const REAL *slope, REAL *root, int64_t count, int64_t uvs, int64_t slopes, int64_t places,
    int64_t rows, int64_t columns, double low_, double high_, int64_t refinements, int64_t tiles, int64_t threads
) {
    const NAME(Field) field = {height, columns + 2, (REAL)rows, (REAL)columns, tiles};
    const REAL low = (REAL)low_, high = (REAL)high_, span = (REAL)(high_ - low_);
    const int64_t runs = (places + RAYS_AT_A_TIME - 1) / RAYS_AT_A_TIME;
#pragma omp parallel for num_threads((int)threads) schedule(dynamic)
    for (int64_t run = 0; run < count * runs; run++) {
        const int64_t number = run / runs, begin = run % runs * RAYS_AT_A_TIME;
        const int64_t end = begin + RAYS_AT_A_TIME < places ? begin + RAYS_AT_A_TIME : places;
        const REAL *u = uv + (uvs == 1 ? 0 : number) * 2 * places, *v = u + places;
        const REAL *along = slope + number * 2 * slopes;
        for (int64_t i = begin; i < end; i++) {
            const int64_t which = slopes == 1 ? 0 : i;
            const REAL across = along[which] * columns, up = along[slopes + which] * rows;
            const REAL x = u[i] * columns - (REAL)0.5, y = (1 - v[i]) * rows - (REAL)0.5;
            const REAL steps = NAME(steps_of)(across, up, span);
            REAL last = high, gap_last = NAME(surface)(&field, x + high * across, y - high * up) - high;
            REAL above = high, below = high, gap_above = gap_last, gap_below = gap_last;
            for (REAL step = 0; step <= steps; step++) {
                const REAL z = high - span * (step / steps);
                const REAL here = NAME(surface)(&field, x + z * across, y - z * up) - z;
                if (here >= 0) {
                    above = last, below = z, gap_above = gap_last, gap_below = here;
                    break;
                }
                last = z, gap_last = here;
            }
            for (int again = 0; again < refinements; again++) {
                const REAL z = above + NAME(share_of)(gap_above, gap_below) * (below - above);
                const REAL here = NAME(surface)(&field, x + z * across, y - z * up) - z;
                if (here < 0)
                    above = z, gap_above = here;
                else
                    below = z, gap_below = here;
            }
            root[number * places + i] = above + NAME(share_of)(gap_above, gap_below) * (below - above);
        }
    }
}

// Find by how much rays from the surface miss it: least [count, places], and how high they are there, rise, or NULL.
//
// With `rise` what a flat surface leaves free does not count. Arrays are those of `first_roots`.
void NAME(clearances)(
    const REAL *height, const REAL *uv, const REAL *slope, REAL *least_, REAL *rise, int64_t count, int64_t uvs, int64_t slopes,
    int64_t places, int64_t rows, int64_t columns, double span_, double highest_, double shortest, int64_t tiles, int64_t threads
) {
    const NAME(Field) field = {height, columns + 2, (REAL)rows, (REAL)columns, tiles};
    const REAL span = (REAL)span_, highest = (REAL)highest_;
    const int64_t runs = (places + RAYS_AT_A_TIME - 1) / RAYS_AT_A_TIME;
#pragma omp parallel for num_threads((int)threads) schedule(dynamic)
    for (int64_t run = 0; run < count * runs; run++) {
        const int64_t number = run / runs, begin = run % runs * RAYS_AT_A_TIME;
        const int64_t end = begin + RAYS_AT_A_TIME < places ? begin + RAYS_AT_A_TIME : places;
        const REAL *u = uv + (uvs == 1 ? 0 : number) * 2 * places, *v = u + places;
        const REAL *along = slope + number * 2 * slopes;
        for (int64_t i = begin; i < end; i++) {
            const int64_t which = slopes == 1 ? 0 : i;
            const REAL right = along[which], ahead = along[slopes + which];
            const REAL across = right * columns, up = ahead * rows;
            const REAL x = u[i] * columns - (REAL)0.5, y = (1 - v[i]) * rows - (REAL)0.5;
            REAL length = SQRT(right * right + ahead * ahead);
            length = length > (REAL)shortest ? length : (REAL)shortest;
            const REAL start = NAME(surface)(&field, x, y), steps = NAME(steps_of)(across, up, span);
            REAL least = rise ? (REAL)INFINITY : 1 / length, there = span;
            for (REAL step = 1; span > 0 && step <= steps; step++) {
                const REAL z = span * (step / steps), far = z * length;
                // The highest point of all would leave so much free, and further on more.
                if ((start + z - highest) / far >= least) break;
                const REAL here = (start + z - NAME(surface)(&field, x + z * across, y - z * up)) / far;
                if (here < least) least = here, there = z;
            }
            least_[number * places + i] = least;
            if (rise) rise[number * places + i] = there;
        }
    }
}
