// Maps looked up at places, bilinearly or bicubically, and the gradients of that.
//
// Maps are packed first: wider by BORDER texels on each side, so that no place has to ask where the map ends, and four
// channels beside each other, which one instruction reads. The packed gradient is added to in the order of the places.

enum { BORDER = 3, LANES = 4, PLACES_AT_A_TIME = 2048 };

// Return the texel that stands at place `i` of a map of `size` that goes on beyond its ends.
static inline int64_t texel_at(int64_t i, int64_t size, int64_t tiles) {
    if (tiles) {
        i %= size;
        return i < 0 ? i + size : i;
    }
    return i < 0 ? 0 : i >= size ? size - 1 : i;
}

typedef REAL NAME(four) __attribute__((vector_size(4 * sizeof(REAL)), aligned(sizeof(REAL)), may_alias));

// Where one place lies: its first tap on the packed map, and the weights of the taps and their slopes.
typedef struct {
    int64_t first;
    REAL across[4], down[4], slope_across[4], slope_down[4];
} NAME(Place);

static inline void NAME(cubic)(REAL t, REAL *weight, REAL *slope) {
    const REAL a = (REAL)-0.75;
    REAL x = t + 1;
    weight[0] = ((a * x - 5 * a) * x + 8 * a) * x - 4 * a;
    weight[1] = ((a + 2) * t - (a + 3)) * t * t + 1;
    x = 1 - t;
    weight[2] = ((a + 2) * x - (a + 3)) * x * x + 1;
    x = 2 - t;
    weight[3] = ((a * x - 5 * a) * x + 8 * a) * x - 4 * a;
    x = 1 + t;
    slope[0] = (3 * a * x - 10 * a) * x + 8 * a;
    slope[1] = (3 * (a + 2) * t - 2 * (a + 3)) * t;
    x = 1 - t;
    slope[2] = -(3 * (a + 2) * x - 2 * (a + 3)) * x;
    x = 2 - t;
    slope[3] = -((3 * a * x - 10 * a) * x + 8 * a);
}

// Find the first tap along one axis, and the weights, for a place `at` in texels, 0 at the first one's centre.
static inline int64_t NAME(axis)(REAL at, int64_t size, int64_t tiles, int64_t cubic, REAL *weight, REAL *slope) {
    int held = 0;
    if (!tiles && !cubic) {
        held = !(at > 0 && at < size - 1);
        at = at < 0 ? 0 : at > size - 1 ? (REAL)(size - 1) : at;
    }
    REAL below = FLOOR(at), t = at - below;
    int64_t first = !(below >= -2) ? -2 : below > size ? size : (int64_t)below;
    if (cubic) {
        NAME(cubic)(t, weight, slope);
        return first - 1;
    }
    weight[0] = 1 - t;
    weight[1] = t;
    slope[0] = held ? 0 : -1;
    slope[1] = held ? 0 : 1;
    return first;
}

static inline NAME(Place) NAME(place_of)(REAL u, REAL v, int64_t rows, int64_t columns, int64_t tiles, int64_t cubic) {
    NAME(Place) place;
    v = 1 - v;
    if (tiles) {
        u -= FLOOR(u);
        v -= FLOOR(v);
    }
    int64_t x = NAME(axis)(u * columns - (REAL)0.5, columns, tiles, cubic, place.across, place.slope_across);
    int64_t y = NAME(axis)(v * rows - (REAL)0.5, rows, tiles, cubic, place.down, place.slope_down);
    place.first = (y + BORDER) * (columns + 2 * BORDER) + x + BORDER;
    return place;
}

// Pack maps [count, channels, rows, columns] into [count, groups, rows + 2 BORDER, columns + 2 BORDER, lanes].
void NAME(pack)(
    const REAL *maps, REAL *packed, int64_t count, int64_t channels, int64_t rows, int64_t columns, int64_t tiles, int64_t threads
) {
    const int64_t lanes = channels == 1 ? 1 : LANES, groups = (channels + lanes - 1) / lanes;
    const int64_t high = rows + 2 * BORDER, wide = columns + 2 * BORDER;
#pragma omp parallel for num_threads((int)threads) schedule(static)
    for (int64_t line = 0; line < count * groups * high; line++) {
        const int64_t number = line / (groups * high), group = line / high % groups;
        const int64_t row = texel_at(line % high - BORDER, rows, tiles);
        REAL *to = packed + line * wide * lanes;
        for (int64_t lane = 0; lane < lanes; lane++) {
            const int64_t channel = group * lanes + lane;
            if (channel >= channels) {
                for (int64_t x = 0; x < wide; x++) to[x * lanes + lane] = 0;
                continue;
            }
            const REAL *from = maps + ((number * channels + channel) * rows + row) * columns;
            for (int64_t x = 0; x < BORDER; x++) to[x * lanes + lane] = from[texel_at(x - BORDER, columns, tiles)];
            for (int64_t x = 0; x < columns; x++) to[(x + BORDER) * lanes + lane] = from[x];
            for (int64_t x = columns; x < columns + BORDER; x++) to[(x + BORDER) * lanes + lane] = from[texel_at(x, columns, tiles)];
        }
    }
}

// Add packed gradients [strips, groups, ...] to maps [channels, rows, columns] `count` times: the other way of `pack`.
void NAME(unpack)(
    const REAL *packed, REAL *maps, int64_t count, int64_t strips, int64_t channels, int64_t rows, int64_t columns, int64_t tiles,
    int64_t threads
) {
    const int64_t lanes = channels == 1 ? 1 : LANES, groups = (channels + lanes - 1) / lanes;
    const int64_t high = rows + 2 * BORDER, wide = columns + 2 * BORDER, size = groups * high * wide * lanes;
#pragma omp parallel for num_threads((int)threads) schedule(static)
    for (int64_t plane = 0; plane < count * channels; plane++) {
        const int64_t number = plane / channels, channel = plane % channels;
        REAL *to = maps + plane * rows * columns;
        memset(to, 0, rows * columns * sizeof(REAL));
        for (int64_t strip = 0; strip < strips; strip++) {
            const REAL *from = packed + (number * strips + strip) * size + channel / lanes * high * wide * lanes + channel % lanes;
            for (int64_t y = 0; y < high; y++) {
                REAL *line = to + texel_at(y - BORDER, rows, tiles) * columns;
                const REAL *of = from + y * wide * lanes;
                for (int64_t x = 0; x < BORDER; x++) line[texel_at(x - BORDER, columns, tiles)] += of[x * lanes];
                for (int64_t x = 0; x < columns; x++) line[x] += of[(x + BORDER) * lanes];
                for (int64_t x = columns; x < columns + BORDER; x++) line[texel_at(x, columns, tiles)] += of[(x + BORDER) * lanes];
            }
        }
    }
}

static inline REAL NAME(sum_of)(NAME(four) v) { return (v[0] + v[1]) + (v[2] + v[3]); }

// Look up packed maps [maps, ...] at uv [uvs, 2, places]: out [count, channels, places]. maps and uvs are 1 or count.
void NAME(look_up)(
    const REAL *packed, const REAL *uv, REAL *out, int64_t count, int64_t maps, int64_t uvs, int64_t channels, int64_t rows,
    int64_t columns, int64_t places, int64_t cubic, int64_t tiles, int64_t threads
) {
    const int64_t lanes = channels == 1 ? 1 : LANES, groups = (channels + lanes - 1) / lanes, taps = cubic ? 4 : 2;
    const int64_t wide = columns + 2 * BORDER, plane = (rows + 2 * BORDER) * wide * lanes;
    const int64_t runs = (places + PLACES_AT_A_TIME - 1) / PLACES_AT_A_TIME;
#pragma omp parallel for num_threads((int)threads) schedule(static)
    for (int64_t run = 0; run < count * runs; run++) {
        const int64_t number = run / runs, begin = run % runs * PLACES_AT_A_TIME;
        const int64_t end = begin + PLACES_AT_A_TIME < places ? begin + PLACES_AT_A_TIME : places;
        const REAL *u = uv + (uvs == 1 ? 0 : number) * 2 * places, *v = u + places;
        const REAL *map = packed + (maps == 1 ? 0 : number) * groups * plane;
        REAL *to = out + number * channels * places;
        for (int64_t i = begin; i < end; i++) {
            const NAME(Place) place = NAME(place_of)(u[i], v[i], rows, columns, tiles, cubic);
            if (lanes == 1) {
                const REAL *tap = map + place.first;
                REAL total = 0;
                for (int64_t y = 0; y < taps; y++, tap += wide) {
                    REAL line = 0;
                    for (int64_t x = 0; x < taps; x++) line += place.across[x] * tap[x];
                    total += place.down[y] * line;
                }
                to[i] = total;
                continue;
            }
            for (int64_t group = 0; group < groups; group++) {
                const REAL *tap = map + group * plane + place.first * LANES;
                NAME(four) total = {0, 0, 0, 0};
                if (cubic) {
                    for (int y = 0; y < 4; y++, tap += wide * LANES) {
                        const NAME(four) *four = (const NAME(four) *)tap;
                        total += place.down[y] * (place.across[0] * four[0] + place.across[1] * four[1]
                                                  + place.across[2] * four[2] + place.across[3] * four[3]);
                    }
                } else {
                    for (int y = 0; y < 2; y++, tap += wide * LANES) {
                        const NAME(four) *four = (const NAME(four) *)tap;
                        total += place.down[y] * (place.across[0] * four[0] + place.across[1] * four[1]);
                    }
                }
                const int64_t left = channels - group * LANES, some = left < LANES ? left : LANES;
                for (int64_t lane = 0; lane < some; lane++) to[(group * LANES + lane) * places + i] = total[lane];
            }
        }
    }
}

// The gradients of `look_up` for those of its result, `above` [count, channels, places].
//
// packed_gradient [maps, strips, ...] starts as zeros, or is NULL; of one map for all, strip s adds what its share of the
// count says, of many there is one strip each. uv_gradient [count, 2, places], or NULL.
void NAME(look_up_gradients)(
    const REAL *packed, const REAL *uv, const REAL *above, REAL *packed_gradient, REAL *uv_gradient, int64_t count, int64_t maps,
    int64_t uvs, int64_t strips, int64_t channels, int64_t rows, int64_t columns, int64_t places, int64_t cubic, int64_t tiles, int64_t threads
) {
    const int64_t lanes = channels == 1 ? 1 : LANES, groups = (channels + lanes - 1) / lanes, taps = cubic ? 4 : 2;
    const int64_t wide = columns + 2 * BORDER, plane = (rows + 2 * BORDER) * wide * lanes;
    const int64_t shares = maps == 1 ? strips : count;
#pragma omp parallel for num_threads((int)threads) schedule(static)
    for (int64_t share = 0; share < shares; share++)
        for (int64_t number = count * share / shares; number < count * (share + 1) / shares; number++) {
            const REAL *u = uv + (uvs == 1 ? 0 : number) * 2 * places, *v = u + places;
            const REAL *map = packed + (maps == 1 ? 0 : number) * groups * plane;
            REAL *sums = packed_gradient ? packed_gradient + share * groups * plane : 0;
            const REAL *given = above + number * channels * places;
            for (int64_t i = 0; i < places; i++) {
                const NAME(Place) place = NAME(place_of)(u[i], v[i], rows, columns, tiles, cubic);
                REAL across = 0, down = 0;
                if (lanes == 1) {
                    const REAL one = given[i];
                    for (int64_t y = 0; y < taps; y++) {
                        const int64_t at = place.first + y * wide;
                        for (int64_t x = 0; x < taps; x++) {
                            across += place.down[y] * place.slope_across[x] * map[at + x];
                            down += place.slope_down[y] * place.across[x] * map[at + x];
                            if (sums) sums[at + x] += one * place.down[y] * place.across[x];
                        }
                    }
                    across *= one;
                    down *= one;
                } else {
                    NAME(four) of_across = {0, 0, 0, 0}, of_down = {0, 0, 0, 0};
                    for (int64_t group = 0; group < groups; group++) {
                        const int64_t left = channels - group * LANES, some = left < LANES ? left : LANES;
                        const int64_t first = group * plane + place.first * LANES;
                        NAME(four) one = {0, 0, 0, 0};
                        for (int64_t lane = 0; lane < some; lane++) one[lane] = given[(group * LANES + lane) * places + i];
                        for (int64_t y = 0; y < taps; y++) {
                            const NAME(four) weighed = one * place.down[y], steep = one * place.slope_down[y];
                            const NAME(four) *four = (const NAME(four) *)(map + first + y * wide * LANES);
                            if (sums) {
                                NAME(four) *to = (NAME(four) *)(sums + first + y * wide * LANES);
                                for (int64_t x = 0; x < taps; x++) to[x] += weighed * place.across[x];
                            }
                            if (uv_gradient)
                                for (int64_t x = 0; x < taps; x++) {
                                    of_across += weighed * place.slope_across[x] * four[x];
                                    of_down += steep * place.across[x] * four[x];
                                }
                        }
                    }
                    across = NAME(sum_of)(of_across);
                    down = NAME(sum_of)(of_down);
                }
                if (uv_gradient) {
                    REAL *to = uv_gradient + number * 2 * places;
                    to[i] = across * columns;
                    to[places + i] = -down * rows;
                }
            }
        }
}
