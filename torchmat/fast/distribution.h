// The distribution material's value and the gradients of all its maps, in one pass over texels and samples.
//
// It is `Distribution._masked`: C_d N.L + pi mask C_s(H) F N.L / D with Smith's denominator D. What a sample is for all
// texels (half vector, Schlick's rise) is given. A few texels at a time go through all samples, so that their maps and
// sums stay near; what all texels share is summed strip by strip, a fixed number of them.

enum { STRIPS = 16 };
#define LOOK_OF                                                                                                       \
    const REAL *light, const REAL *view, const REAL *half, const REAL *rise, const REAL *frame, const REAL *diffuse, \
        const REAL *mask, const REAL *fresnel, const REAL *index, const REAL *table, const REAL *squares,             \
        int64_t count, int64_t texels, int64_t size, int64_t lobes, int64_t mask_channels, int64_t dense
#define LOOK_HERE                                                                                                  \
    {light, view, half, rise, frame, diffuse, mask, fresnel, index, table, squares[0], squares[1], texels, size, \
     lobes, mask_channels, dense}

// What is looked at: samples light, view, half [count, 3] and rise [count]; maps of `texels`, NULL for one that is not there:
// frame [xyz, along across normal], diffuse [3], mask [mask_channels], fresnel, index [lobes]; `table` packed specular maps.
typedef struct {
    const REAL *light, *view, *half, *rise, *frame, *diffuse, *mask, *fresnel, *index, *table;
    REAL square_u, square_v;
    int64_t texels, size, lobes, mask_channels, dense;
} NAME(Look);

// One sample of some texels: directions in their frames, and what the value is made of.
typedef struct {
    REAL light[3][BLOCK], view[3][BLOCK], half[3][BLOCK], n_dot_l[BLOCK], n_dot_v[BLOCK], light_length[BLOCK], view_length[BLOCK];
    REAL denominator[BLOCK], share[BLOCK], reflected[BLOCK], x[BLOCK], y[BLOCK], s[BLOCK], t[BLOCK], colour[3][BLOCK];
    int32_t at[BLOCK];  // the tap to the upper left on a packed table, and how far from it: s to the right, t down
} NAME(Seen);

// Two taps side by side on the packed table.
typedef REAL NAME(eight) __attribute__((vector_size(8 * sizeof(REAL)), aligned(sizeof(REAL)), may_alias));

static inline NAME(eight) NAME(both)(REAL left, REAL right) {
    return (NAME(eight)){left, left, left, left, right, right, right, right};
}

static inline NAME(four) NAME(left_of)(NAME(eight) pair) { return (NAME(four)){pair[0], pair[1], pair[2], pair[3]}; }
static inline NAME(four) NAME(right_of)(NAME(eight) pair) { return (NAME(four)){pair[4], pair[5], pair[6], pair[7]}; }

static inline void NAME(turned)(const NAME(Look) *look, const REAL *direction, int64_t first, int64_t some, REAL to[3][BLOCK]) {
    for (int axis = 0; axis < 3; axis++) {
        if (!look->frame) {
            for (int64_t i = 0; i < some; i++) to[axis][i] = direction[axis];
            continue;
        }
        const REAL *x = look->frame + axis * look->texels + first, *y = x + 3 * look->texels, *z = y + 3 * look->texels;
        for (int64_t i = 0; i < some; i++) to[axis][i] = direction[0] * x[i] + direction[1] * y[i] + direction[2] * z[i];
    }
}

// What directions in the texels' frames say: Smith's share, and the place on the table.
static inline void NAME(measure)(const NAME(Look) *look, int64_t some, NAME(Seen) *seen) {
    const REAL u = look->square_u, v = look->square_v, least = (REAL)1e-12;
    const REAL halfway = (REAL)look->size / 2;
    for (int64_t i = 0; i < some; i++) {
        const REAL l = NAME(above)(seen->light[2][i], 0), n = NAME(above)(seen->view[2][i], 0);
        const REAL lx = seen->light[0][i], ly = seen->light[1][i], vx = seen->view[0][i], vy = seen->view[1][i];
        const REAL of_light = SQRT(NAME(above)(l * l + lx * lx * u + ly * ly * v, least));
        const REAL of_view = SQRT(NAME(above)(n * n + vx * vx * u + vy * vy * v, least));
        const REAL denominator = l * of_view + n * of_light + (REAL)1e-4;
        seen->n_dot_l[i] = l, seen->n_dot_v[i] = n;
        seen->light_length[i] = of_light, seen->view_length[i] = of_view;
        seen->denominator[i] = denominator, seen->share[i] = l / denominator;
    }
    for (int64_t i = 0; i < some; i++) {
        const REAL scale = 1 / (1 + NAME(above)(seen->half[2][i], 0));
        const REAL x = seen->half[0][i] * scale, y = seen->half[1][i] * scale;
        const REAL denser = look->dense ? 1 / SQRT(SQRT(x * x + y * y + (REAL)(1.0 / 65536))) : 1;
        seen->x[i] = (x * denser + 1) * halfway - (REAL)0.5;
        seen->y[i] = (1 - y * denser) * halfway - (REAL)0.5;
    }
    const REAL last = (REAL)(look->size - 1);
    const int32_t wide = (int32_t)look->size + 1;
    for (int64_t i = 0; i < some; i++) {
        const REAL x = seen->x[i] < 0 ? 0 : seen->x[i] > last ? last : seen->x[i];
        const REAL y = seen->y[i] < 0 ? 0 : seen->y[i] > last ? last : seen->y[i];
        // No place at all stays one in what is weighed.
        const int32_t left = (int32_t)(x >= 0 ? x : 0), top = (int32_t)(y >= 0 ? y : 0);
        seen->s[i] = x - left, seen->t[i] = y - top, seen->at[i] = top * wide + left;
    }
}

static void NAME(see)(const NAME(Look) *look, int64_t number, int64_t first, int64_t some, NAME(Seen) *seen) {
    NAME(turned)(look, look->light + 3 * number, first, some, seen->light);
    NAME(turned)(look, look->view + 3 * number, first, some, seen->view);
    NAME(turned)(look, look->half + 3 * number, first, some, seen->half);
    NAME(measure)(look, some, seen);
    const REAL rise = look->rise ? look->rise[number] : 0;
    if (look->fresnel)
        for (int64_t i = 0; i < some; i++) {
            const REAL fresnel = look->fresnel[first + i];
            seen->reflected[i] = (REAL)M_PI * (fresnel + (1 - fresnel) * rise);
        }
    else
        for (int64_t i = 0; i < some; i++) seen->reflected[i] = (REAL)M_PI;
}

static void NAME(colours)(const NAME(Look) *look, int64_t first, int64_t some, NAME(Seen) *seen) {
    const int64_t wide = look->size + 1;
    for (int64_t i = 0; i < some; i++) {
        const REAL s = seen->s[i], t = seen->t[i];
        NAME(eight) total = {0, 0, 0, 0, 0, 0, 0, 0};
        for (int64_t lobe = 0; lobe < look->lobes; lobe++) {
            const REAL *tap = look->table + 4 * (lobe * wide * wide + seen->at[i]);
            const REAL weight = look->index ? look->index[lobe * look->texels + first + i] : 1;
            const NAME(eight) upper = *(const NAME(eight) *)tap, lower = *(const NAME(eight) *)(tap + 4 * wide);
            total += weight * (1 - t) * upper + weight * t * lower;
        }
        const NAME(four) found = (1 - s) * NAME(left_of)(total) + s * NAME(right_of)(total);
        for (int c = 0; c < 3; c++) seen->colour[c][i] = found[c];
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

// One channel of the value of what was seen.
static inline void NAME(channel)(const NAME(Look) *look, int64_t c, int64_t first, int64_t some, const NAME(Seen) *seen, REAL *to) {
    const REAL *own = look->diffuse + c * look->texels + first;
    const REAL *weight = look->mask ? look->mask + (look->mask_channels == 3 ? c : 0) * look->texels + first : 0;
    for (int64_t i = 0; i < some; i++)
        to[i] = seen->colour[c][i] * seen->reflected[i] * seen->share[i] * (weight ? weight[i] : 1) + own[i] * seen->n_dot_l[i];
}

// The value [count, 3, texels].
void NAME(distribution)(LOOK_OF, REAL *out, int64_t threads) {
    const NAME(Look) look = LOOK_HERE;
#pragma omp parallel for num_threads((int)threads) schedule(static)
    for (int64_t part = 0; part < (texels + BLOCK - 1) / BLOCK; part++) {
        const int64_t first = part * BLOCK, some = first + BLOCK < texels ? BLOCK : texels - first;
        NAME(Seen) seen;
        for (int64_t number = 0; number < count; number++) {
            NAME(see)(&look, number, first, some, &seen);
            NAME(colours)(&look, first, some, &seen);
            for (int c = 0; c < 3; c++) NAME(channel)(&look, c, first, some, &seen, out + (3 * number + c) * texels + first);
        }
    }
}

// What the gradients are added to; of what all texels share one row a strip.
typedef struct {
    REAL *frame, *diffuse, *mask, *fresnel, *index, *table, *squares, *rise;
} NAME(Sums);

// Carry the gradients of the specular colours, `of_colour`, to the table and to where it is looked up, `of_x` and `of_y`.
static void NAME(pull_colours)(
    const NAME(Look) *look, const NAME(Sums) *sums, int64_t first, int64_t some, const NAME(Seen) *seen,
    REAL of_colour[3][BLOCK], REAL *of_x, REAL *of_y
) {
    const int64_t wide = look->size + 1;
    const REAL last = (REAL)(look->size - 1);
    for (int64_t i = 0; i < some; i++) {
        const REAL s = seen->s[i], t = seen->t[i];
        const NAME(eight) aside = NAME(both)(1 - s, s), apart = NAME(both)(-1, 1);
        const NAME(eight) given = {of_colour[0][i], of_colour[1][i], of_colour[2][i], 0, of_colour[0][i], of_colour[1][i], of_colour[2][i], 0};
        const NAME(eight) weighed = aside * given, pulled = apart * given;
        NAME(eight) across = {0, 0, 0, 0, 0, 0, 0, 0}, down = across;
        for (int64_t lobe = 0; lobe < look->lobes; lobe++) {
            const int64_t at = 4 * (lobe * wide * wide + seen->at[i]), place = lobe * look->texels + first + i;
            const REAL *tap = look->table + at, weight = look->index ? look->index[place] : 1;
            REAL *to = sums->table + at;
            const NAME(eight) upper = *(const NAME(eight) *)tap, lower = *(const NAME(eight) *)(tap + 4 * wide);
            const NAME(eight) row = (1 - t) * upper + t * lower, pull = weight * weighed;
            if (look->index) sums->index[place] += NAME(sum_of)(NAME(left_of)(row * weighed) + NAME(right_of)(row * weighed));
            *(NAME(eight) *)to += (1 - t) * pull;
            *(NAME(eight) *)(to + 4 * wide) += t * pull;
            across += weight * row;
            down += weight * (lower - upper);
        }
        across *= pulled, down *= weighed;
        of_x[i] = seen->x[i] > 0 && seen->x[i] < last ? NAME(sum_of)(NAME(left_of)(across) + NAME(right_of)(across)) : 0;
        of_y[i] = seen->y[i] > 0 && seen->y[i] < last ? NAME(sum_of)(NAME(left_of)(down) + NAME(right_of)(down)) : 0;
    }
}

// Add the gradient of a turned direction to that of the frame.
static inline void NAME(pull_frame)(
    const NAME(Look) *look, REAL *sums, const REAL *direction, int64_t first, int64_t some, REAL of[3][BLOCK]
) {
    for (int from = 0; from < 3; from++)
        for (int axis = 0; axis < 3; axis++) {
            REAL *to = sums + (3 * from + axis) * look->texels + first;
            for (int64_t i = 0; i < some; i++) to[i] += direction[from] * of[axis][i];
        }
}

// `above` are the gradients of the value of these texels, one channel `apart` from the next.
static void NAME(pull)(
    const NAME(Look) *look, const NAME(Sums) *sums, int64_t number, int64_t first, int64_t some, const NAME(Seen) *seen, const REAL *above,
    int64_t apart
) {
    REAL of_colour[3][BLOCK], of_lobe[BLOCK], of_l[BLOCK], of_light[3][BLOCK], of_view[3][BLOCK], of_half[3][BLOCK], of_x[BLOCK], of_y[BLOCK];
    const int64_t texels = look->texels;
    for (int64_t i = 0; i < some; i++) of_lobe[i] = of_l[i] = 0;
    for (int c = 0; c < 3; c++) {
        const REAL *given = above + c * apart, *own = look->diffuse + c * texels + first;
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
    REAL of_u[BLOCK], of_v[BLOCK];
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
        const REAL z = seen->half[2][i], scale = 1 / (1 + NAME(above)(z, 0));
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

// Zeros where the gradients of some texels and of one strip are added up.
static void NAME(nothing_yet)(const NAME(Look) *look, const NAME(Sums) *sums, int64_t count, int64_t first, int64_t some) {
    REAL *const planes[] = {sums->frame, sums->diffuse, sums->mask, sums->fresnel, sums->index};
    const int64_t many[] = {9, 3, look->mask_channels, 1, look->lobes}, wide = look->size + 1;
    for (int plane = 0; plane < 5; plane++)
        for (int64_t c = 0; planes[plane] && c < many[plane]; c++) memset(planes[plane] + c * look->texels + first, 0, some * sizeof(REAL));
    memset(sums->table, 0, 4 * look->lobes * wide * wide * sizeof(REAL));
    memset(sums->rise, 0, count * sizeof(REAL));
    sums->squares[0] = sums->squares[1] = 0;
}

// Add up the strips, one after the other, onto the first.
static void NAME(gather)(REAL *strips, int64_t size, int64_t threads) {
#pragma omp parallel for num_threads((int)threads) schedule(static)
    for (int64_t part = 0; part < (size + 1023) / 1024; part++)
        for (int64_t strip = 1; strip < STRIPS; strip++)
            for (int64_t i = 1024 * part; i < 1024 * (part + 1) && i < size; i++) strips[i] += strips[strip * size + i];
}

// The gradient of specular maps for that of their packed table, whose last row and column go on.
static void NAME(taken_from_table)(const REAL *of_table, REAL *of_specular, int64_t lobes, int64_t size) {
    const int64_t wide = size + 1;
    memset(of_specular, 0, 3 * lobes * size * size * sizeof(REAL));
    for (int64_t at = 0; at < lobes * wide * wide; at++) {
        const int64_t lobe = at / (wide * wide), y = at / wide % wide, x = at % wide;
        const int64_t to = (y < size ? y : size - 1) * size + (x < size ? x : size - 1);
        for (int64_t c = 0; c < 3; c++) of_specular[(3 * lobe + c) * size * size + to] += of_table[4 * at + c];
    }
}

#define GRADIENTS_OF                                                                                                          \
    REAL *of_frame, REAL *of_diffuse, REAL *of_mask, REAL *of_fresnel, REAL *of_index, REAL *of_specular, REAL *of_squares, \
        REAL *of_rise, REAL *of_table
#define GRADIENTS_HERE                                                                                                            \
    {of_frame, of_diffuse, of_mask, of_fresnel, of_index, of_table + strip * entries, of_squares + 2 * strip, of_rise + count * strip}
#define GRADIENTS_DONE                              \
    NAME(gather)(of_table, entries, threads);       \
    NAME(gather)(of_squares, 2, 1);                 \
    NAME(gather)(of_rise, count, 1);                \
    NAME(taken_from_table)(of_table, of_specular, lobes, size);

// The gradients for those of the value, `above` [count, 3, texels]. Table, squares and rise have STRIPS rows, of which the first ends
// as their sum.
void NAME(distribution_gradients)(LOOK_OF, const REAL *above, GRADIENTS_OF, int64_t threads) {
    const NAME(Look) look = LOOK_HERE;
    const int64_t parts = (texels + BLOCK - 1) / BLOCK, entries = 4 * lobes * (size + 1) * (size + 1);
#pragma omp parallel for num_threads((int)threads) schedule(static)
    for (int64_t strip = 0; strip < STRIPS; strip++) {
        const NAME(Sums) sums = GRADIENTS_HERE;
        NAME(Seen) seen;
        const int64_t from = parts * strip / STRIPS * BLOCK, to = parts * (strip + 1) / STRIPS * BLOCK;
        NAME(nothing_yet)(&look, &sums, count, from, (to < texels ? to : texels) - from);
        for (int64_t part = parts * strip / STRIPS; part < parts * (strip + 1) / STRIPS; part++) {
            const int64_t first = part * BLOCK, some = first + BLOCK < texels ? BLOCK : texels - first;
            for (int64_t number = 0; number < count; number++) {
                NAME(see)(&look, number, first, some, &seen);
                NAME(colours)(&look, first, some, &seen);
                NAME(pull)(&look, &sums, number, first, some, &seen, above + 3 * number * texels + first, texels);
            }
        }
    }
    GRADIENTS_DONE
}
