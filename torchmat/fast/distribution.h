// The distribution material's value and the gradients of all its maps, in one pass over texels and samples.
//
// It is `Distribution._masked`: C_d N.L + pi mask C_s(H) F N.L / D with Smith's denominator D. What a sample is for all
// texels (half vector, Schlick's rise) is given. A few texels at a time go through all samples, so that their maps and
// sums stay near; what all texels share is summed strip by strip, a fixed number of them.

#ifndef DISTRIBUTION_SHARED
#define DISTRIBUTION_SHARED
enum { SOME = 64, STRIPS = 16 };
#endif

// What is looked at: samples light, view, half [count, 3] and rise [count]; maps of `texels`, NULL for one that is not there:
// frame [xyz, along across normal], diffuse [3], mask [mask_channels], fresnel, index [lobes]; `table` packed specular maps.
typedef struct {
    const REAL *light, *view, *half, *rise, *frame, *diffuse, *mask, *fresnel, *index, *table;
    REAL square_u, square_v;
    int64_t texels, size, lobes, mask_channels, dense;
} NAME(Look);

// One sample of some texels: directions in their frames, and what the value is made of.
typedef struct {
    REAL light[3][SOME], view[3][SOME], half[3][SOME], n_dot_l[SOME], n_dot_v[SOME], light_length[SOME], view_length[SOME];
    REAL denominator[SOME], share[SOME], reflected[SOME], x[SOME], y[SOME], colour[3][SOME];
} NAME(Seen);

static inline void NAME(turned)(const NAME(Look) *look, const REAL *direction, int64_t first, int64_t some, REAL to[3][SOME]) {
    for (int axis = 0; axis < 3; axis++) {
        if (!look->frame) {
            for (int64_t i = 0; i < some; i++) to[axis][i] = direction[axis];
            continue;
        }
        const REAL *x = look->frame + axis * look->texels + first, *y = x + 3 * look->texels, *z = y + 3 * look->texels;
        for (int64_t i = 0; i < some; i++) to[axis][i] = direction[0] * x[i] + direction[1] * y[i] + direction[2] * z[i];
    }
}

static inline REAL NAME(not_below)(REAL x, REAL least) { return x < least ? least : x; }

static void NAME(see)(const NAME(Look) *look, int64_t number, int64_t first, int64_t some, NAME(Seen) *seen) {
    NAME(turned)(look, look->light + 3 * number, first, some, seen->light);
    NAME(turned)(look, look->view + 3 * number, first, some, seen->view);
    NAME(turned)(look, look->half + 3 * number, first, some, seen->half);
    const REAL u = look->square_u, v = look->square_v, least = (REAL)1e-12, rise = look->rise ? look->rise[number] : 0;
    const REAL halfway = (REAL)look->size / 2;
    for (int64_t i = 0; i < some; i++) {
        const REAL l = NAME(not_below)(seen->light[2][i], 0), n = NAME(not_below)(seen->view[2][i], 0);
        const REAL lx = seen->light[0][i], ly = seen->light[1][i], vx = seen->view[0][i], vy = seen->view[1][i];
        const REAL of_light = SQRT(NAME(not_below)(l * l + lx * lx * u + ly * ly * v, least));
        const REAL of_view = SQRT(NAME(not_below)(n * n + vx * vx * u + vy * vy * v, least));
        const REAL denominator = l * of_view + n * of_light + (REAL)1e-4;
        seen->n_dot_l[i] = l, seen->n_dot_v[i] = n;
        seen->light_length[i] = of_light, seen->view_length[i] = of_view;
        seen->denominator[i] = denominator, seen->share[i] = l / denominator;
    }
    for (int64_t i = 0; i < some; i++) {
        const REAL scale = 1 / (1 + NAME(not_below)(seen->half[2][i], 0));
        const REAL x = seen->half[0][i] * scale, y = seen->half[1][i] * scale;
        const REAL denser = look->dense ? 1 / SQRT(SQRT(x * x + y * y + (REAL)(1.0 / 65536))) : 1;
        seen->x[i] = (x * denser + 1) * halfway - (REAL)0.5;
        seen->y[i] = (1 - y * denser) * halfway - (REAL)0.5;
    }
    if (look->fresnel)
        for (int64_t i = 0; i < some; i++) {
            const REAL fresnel = look->fresnel[first + i];
            seen->reflected[i] = (REAL)M_PI * (fresnel + (1 - fresnel) * rise);
        }
    else
        for (int64_t i = 0; i < some; i++) seen->reflected[i] = (REAL)M_PI;
}

// Where a place lies on the packed table, of which each texel has four lanes; no place at all stays one in what is weighed.
static inline const NAME(four) *NAME(tap)(const NAME(Look) *look, REAL x, REAL y, int64_t lobe, REAL *s, REAL *t, int64_t *at) {
    const REAL last = (REAL)(look->size - 1);
    x = x < 0 ? 0 : x > last ? last : x;
    y = y < 0 ? 0 : y > last ? last : y;
    const int64_t left = x >= 0 ? (int64_t)x : 0, top = y >= 0 ? (int64_t)y : 0, wide = look->size + 1;
    *s = x - left, *t = y - top;
    *at = (lobe * wide + top) * wide + left;
    return (const NAME(four) *)look->table + *at;
}

static void NAME(colours)(const NAME(Look) *look, int64_t first, int64_t some, NAME(Seen) *seen) {
    const int64_t wide = look->size + 1;
    for (int64_t i = 0; i < some; i++) {
        NAME(four) total = {0, 0, 0, 0};
        for (int64_t lobe = 0; lobe < look->lobes; lobe++) {
            REAL s, t;
            int64_t at;
            const NAME(four) *tap = NAME(tap)(look, seen->x[i], seen->y[i], lobe, &s, &t, &at);
            const REAL weight = look->index ? look->index[lobe * look->texels + first + i] : 1;
            total += weight * ((1 - t) * ((1 - s) * tap[0] + s * tap[1]) + t * ((1 - s) * tap[wide] + s * tap[wide + 1]));
        }
        for (int c = 0; c < 3; c++) seen->colour[c][i] = total[c];
    }
}

// Pack specular maps [3 lobes, size, size] into [lobes, size + 1, size + 1, 4]: the last row and column go on.
void NAME(distribution_table)(const REAL *specular, REAL *table, int64_t lobes, int64_t size, int64_t threads) {
    const int64_t wide = size + 1;
    for (int64_t at = 0; at < lobes * wide * wide; at++) {
        const int64_t lobe = at / (wide * wide), y = at / wide % wide, x = at % wide;
        const int64_t from = (y < size ? y : size - 1) * size + (x < size ? x : size - 1);
        for (int64_t c = 0; c < 4; c++) table[4 * at + c] = c < 3 ? specular[(3 * lobe + c) * size * size + from] : 0;
    }
    (void)threads;
}

#define LOOK_OF                                                                                                       \
    const REAL *light, const REAL *view, const REAL *half, const REAL *rise, const REAL *frame, const REAL *diffuse, \
        const REAL *mask, const REAL *fresnel, const REAL *index, const REAL *table, const REAL *squares,             \
        int64_t count, int64_t texels, int64_t size, int64_t lobes, int64_t mask_channels, int64_t dense
#define LOOK_HERE                                                                                                  \
    {light, view, half, rise, frame, diffuse, mask, fresnel, index, table, squares[0], squares[1], texels, size, \
     lobes, mask_channels, dense}

// The value [count, 3, texels].
void NAME(distribution)(LOOK_OF, REAL *out, int64_t threads) {
    const NAME(Look) look = LOOK_HERE;
#pragma omp parallel for num_threads((int)threads) schedule(static)
    for (int64_t part = 0; part < (texels + SOME - 1) / SOME; part++) {
        const int64_t first = part * SOME, some = first + SOME < texels ? SOME : texels - first;
        NAME(Seen) seen;
        for (int64_t number = 0; number < count; number++) {
            NAME(see)(&look, number, first, some, &seen);
            NAME(colours)(&look, first, some, &seen);
            for (int c = 0; c < 3; c++) {
                REAL *to = out + (3 * number + c) * texels + first;
                const REAL *own = diffuse + c * texels + first;
                const REAL *weight = mask ? mask + (mask_channels == 3 ? c : 0) * texels + first : 0;
                for (int64_t i = 0; i < some; i++)
                    to[i] = seen.colour[c][i] * seen.reflected[i] * seen.share[i] * (weight ? weight[i] : 1) + own[i] * seen.n_dot_l[i];
            }
        }
    }
}

// What the gradients are added to, all zeros at first; of what all texels share one row a strip.
typedef struct {
    REAL *frame, *diffuse, *mask, *fresnel, *index, *table, *squares, *rise;
} NAME(Sums);

// Carry the gradients of the specular colours, `of_colour`, to the table and to where it is looked up, `of_x` and `of_y`.
static void NAME(pull_colours)(
    const NAME(Look) *look, const NAME(Sums) *sums, int64_t first, int64_t some, const NAME(Seen) *seen,
    REAL of_colour[3][SOME], REAL *of_x, REAL *of_y
) {
    const int64_t wide = look->size + 1;
    const REAL last = (REAL)(look->size - 1);
    for (int64_t i = 0; i < some; i++) {
        NAME(four) across = {0, 0, 0, 0}, down = {0, 0, 0, 0};
        const NAME(four) given = {of_colour[0][i], of_colour[1][i], of_colour[2][i], 0};
        for (int64_t lobe = 0; lobe < look->lobes; lobe++) {
            REAL s, t;
            int64_t at;
            const NAME(four) *tap = NAME(tap)(look, seen->x[i], seen->y[i], lobe, &s, &t, &at);
            const int64_t place = lobe * look->texels + first + i;
            NAME(four) *to = (NAME(four) *)sums->table + at, pull = given;
            if (look->index) {
                const NAME(four) found = (1 - t) * ((1 - s) * tap[0] + s * tap[1]) + t * ((1 - s) * tap[wide] + s * tap[wide + 1]);
                sums->index[place] += NAME(sum_of)(found * given);
                pull = given * look->index[place];
            }
            to[0] += (1 - t) * (1 - s) * pull;
            to[1] += (1 - t) * s * pull;
            to[wide] += t * (1 - s) * pull;
            to[wide + 1] += t * s * pull;
            across += pull * ((1 - t) * (tap[1] - tap[0]) + t * (tap[wide + 1] - tap[wide]));
            down += pull * ((1 - s) * (tap[wide] - tap[0]) + s * (tap[wide + 1] - tap[1]));
        }
        of_x[i] = seen->x[i] > 0 && seen->x[i] < last ? NAME(sum_of)(across) : 0;
        of_y[i] = seen->y[i] > 0 && seen->y[i] < last ? NAME(sum_of)(down) : 0;
    }
}

// Add the gradient of a turned direction to that of the frame.
static inline void NAME(pull_frame)(
    const NAME(Look) *look, REAL *sums, const REAL *direction, int64_t first, int64_t some, REAL of[3][SOME]
) {
    for (int from = 0; from < 3; from++)
        for (int axis = 0; axis < 3; axis++) {
            REAL *to = sums + (3 * from + axis) * look->texels + first;
            for (int64_t i = 0; i < some; i++) to[i] += direction[from] * of[axis][i];
        }
}

static void NAME(pull)(
    const NAME(Look) *look, const NAME(Sums) *sums, int64_t number, int64_t first, int64_t some, const NAME(Seen) *seen, const REAL *above
) {
    REAL of_colour[3][SOME], of_lobe[SOME], of_l[SOME], of_light[3][SOME], of_view[3][SOME], of_half[3][SOME], of_x[SOME], of_y[SOME];
    const int64_t texels = look->texels;
    for (int64_t i = 0; i < some; i++) of_lobe[i] = of_l[i] = 0;
    for (int c = 0; c < 3; c++) {
        const REAL *given = above + c * texels + first, *own = look->diffuse + c * texels + first;
        REAL *to = sums->diffuse + c * texels + first;
        const int64_t channel = (look->mask_channels == 3 ? c : 0) * texels + first;
        for (int64_t i = 0; i < some; i++) {
            to[i] += given[i] * seen->n_dot_l[i];
            of_l[i] += given[i] * own[i];
        }
        if (look->mask)
            for (int64_t i = 0; i < some; i++) {
                const REAL lobe = seen->share[i] * seen->reflected[i], weight = look->mask[channel + i];
                const REAL pulled = given[i] * seen->colour[c][i];
                of_colour[c][i] = given[i] * lobe * weight;
                sums->mask[channel + i] += pulled * lobe;
                of_lobe[i] += pulled * weight;
            }
        else
            for (int64_t i = 0; i < some; i++) {
                of_colour[c][i] = given[i] * seen->share[i] * seen->reflected[i];
                of_lobe[i] += given[i] * seen->colour[c][i];
            }
    }
    if (look->fresnel) {
        const REAL rise = look->rise[number];
        REAL total = 0;
        for (int64_t i = 0; i < some; i++) {
            const REAL pulled = of_lobe[i] * seen->share[i] * (REAL)M_PI;
            sums->fresnel[first + i] += pulled * (1 - rise);
            total += pulled * (1 - look->fresnel[first + i]);
        }
        sums->rise[number] += total;
    }
    NAME(pull_colours)(look, sums, first, some, seen, of_colour, of_x, of_y);
    const REAL u = look->square_u, v = look->square_v, least = (REAL)1e-12, halfway = (REAL)look->size / 2;
    REAL of_u[SOME], of_v[SOME];
    for (int64_t i = 0; i < some; i++) {
        const REAL of_share = of_lobe[i] * seen->reflected[i], of_denominator = -of_share * seen->share[i] / seen->denominator[i];
        const REAL lx = seen->light[0][i], ly = seen->light[1][i], vx = seen->view[0][i], vy = seen->view[1][i];
        const REAL light = seen->light_length[i], view = seen->view_length[i], l = seen->n_dot_l[i], n = seen->n_dot_v[i];
        // A length at its least does not change.
        const REAL to_light = light * light > least * (REAL)1.0001 ? of_denominator * n / light : 0;
        const REAL to_view = view * view > least * (REAL)1.0001 ? of_denominator * l / view : 0;
        const REAL to_l = of_l[i] + of_share / seen->denominator[i] + of_denominator * view + to_light * l;
        const REAL to_n = of_denominator * light + to_view * n;
        of_light[0][i] = to_light * lx * u, of_light[1][i] = to_light * ly * v;
        of_light[2][i] = seen->light[2][i] < 0 ? 0 : to_l;
        of_view[0][i] = to_view * vx * u, of_view[1][i] = to_view * vy * v;
        of_view[2][i] = seen->view[2][i] < 0 ? 0 : to_n;
        of_u[i] = (to_light * lx * lx + to_view * vx * vx) / 2;
        of_v[i] = (to_light * ly * ly + to_view * vy * vy) / 2;
    }
    REAL total_u = 0, total_v = 0;
    for (int64_t i = 0; i < some; i++) total_u += of_u[i], total_v += of_v[i];
    sums->squares[0] += total_u, sums->squares[1] += total_v;
    if (!look->frame) return;
    for (int64_t i = 0; i < some; i++) {
        const REAL z = seen->half[2][i], scale = 1 / (1 + NAME(not_below)(z, 0));
        const REAL x = seen->half[0][i] * scale, y = seen->half[1][i] * scale;
        REAL to_x = of_x[i] * halfway, to_y = -of_y[i] * halfway;
        if (look->dense) {
            const REAL squared = x * x + y * y + (REAL)(1.0 / 65536), denser = 1 / SQRT(SQRT(squared));
            const REAL inward = (to_x * x + to_y * y) * denser / (2 * squared);
            to_x = to_x * denser - inward * x;
            to_y = to_y * denser - inward * y;
        }
        of_half[0][i] = to_x * scale, of_half[1][i] = to_y * scale;
        of_half[2][i] = z < 0 ? 0 : -(to_x * x + to_y * y) * scale;
    }
    NAME(pull_frame)(look, sums->frame, look->light + 3 * number, first, some, of_light);
    NAME(pull_frame)(look, sums->frame, look->view + 3 * number, first, some, of_view);
    NAME(pull_frame)(look, sums->frame, look->half + 3 * number, first, some, of_half);
}

// The gradients for those of the value, `above` [count, 3, texels]. Of those with a strip there are STRIPS rows, to be added up.
void NAME(distribution_gradients)(
    LOOK_OF, const REAL *above, REAL *of_frame, REAL *of_diffuse, REAL *of_mask, REAL *of_fresnel, REAL *of_index, REAL *of_table,
    REAL *of_squares, REAL *of_rise, int64_t threads
) {
    const NAME(Look) look = LOOK_HERE;
    const int64_t parts = (texels + SOME - 1) / SOME, entries = 4 * lobes * (size + 1) * (size + 1);
#pragma omp parallel for num_threads((int)threads) schedule(static)
    for (int64_t strip = 0; strip < STRIPS; strip++) {
        const NAME(Sums) sums = {
            of_frame, of_diffuse, of_mask, of_fresnel, of_index, of_table + strip * entries, of_squares + 2 * strip, of_rise + count * strip,
        };
        NAME(Seen) seen;
        for (int64_t part = parts * strip / STRIPS; part < parts * (strip + 1) / STRIPS; part++) {
            const int64_t first = part * SOME, some = first + SOME < texels ? SOME : texels - first;
            for (int64_t number = 0; number < count; number++) {
                NAME(see)(&look, number, first, some, &seen);
                NAME(colours)(&look, first, some, &seen);
                NAME(pull)(&look, &sums, number, first, some, &seen, above + 3 * number * texels);
            }
        }
    }
}
#undef LOOK_OF
#undef LOOK_HERE
