// The measured pairs of light and view that lie nearest to others, the weights by which they are interpolated, and PCA's value.
//
// It is models/angular.py. Pairs are few lights by few views: about the cell where a query's light lies, lights are walked in
// the order of their distance from its centre, and views likewise, until none that is left can be nearer than those found.

enum { CELLS = 32, NEAR = 12, TOGETHER = 16, MOST_ON_A_SIDE = 512, MOST_FACTORS = 64, EIGHT = 8 };  // as in neighbours.py
#define ONE 16777216.0  // coordinates are whole numbers of 2^-24: squares of distances are exact, and ties are ties

// Lights, or views: places [count, 2], and around the centre of each cell their order and how far away they are.
typedef struct {
    const double *places, *away;
    const int32_t *order;
    int64_t count;
} Side;

// What is walked around one query: order, distances from the centre, and how far the query is from it, or a little more.
typedef struct {
    const double *places, *away;
    const int32_t *order;
    double x, y, off;
} Around;

static inline double cell_of(double at) {
    const double cell = floor((at / ONE + 1) * (CELLS / 2));
    return cell < 0 ? 0 : cell > CELLS - 1 ? CELLS - 1 : cell;
}

static inline Around around(const Side *side, double x, double y) {
    const double column = cell_of(x), row = cell_of(y);
    const double dx = x - ((column + 0.5) / (CELLS / 2) - 1) * ONE, dy = y - ((row + 0.5) / (CELLS / 2) - 1) * ONE;
    const int64_t first = ((int64_t)row * CELLS + (int64_t)column) * side->count;
    return (Around){side->places, side->away + first, side->order + first, x, y, sqrt(dx * dx + dy * dy) + 1};
}

// The squared distance of one of them, and what those from it on have at least.
static inline double distance_of(const Around *of, int64_t number) {
    const double *place = of->places + 2 * of->order[number], dx = place[0] - of->x, dy = place[1] - of->y;
    return dx * dx + dy * dy;
}
static inline double at_least(const Around *of, int64_t number) {
    const double least = of->away[number] - of->off;
    return least > 0 ? least * least : 0;
}

// Find the numbers of the `want` samples nearest to a query; of those as near the lower. `sample` [lights, views] is -1 for none.
static void nearest(const Side *lights, const Side *views, const int32_t *sample, const double *query, int64_t want, int32_t *found) {
    const Around light = around(lights, query[0], query[1]), view = around(views, query[2], query[3]);
    double best[NEAR], apart[MOST_ON_A_SIDE], least[MOST_ON_A_SIDE], worst = INFINITY;
    const double nearest_view = at_least(&view, 0);
    int64_t have = 0, seen = 0;
    for (int64_t i = 0; i < lights->count && at_least(&light, i) + nearest_view <= worst; i++) {
        const double from_light = distance_of(&light, i);
        const int32_t *row = sample + light.order[i] * views->count;
        for (int64_t j = 0; j < views->count; j++) {
            if (j == seen) apart[j] = distance_of(&view, j), least[j] = at_least(&view, j), seen++;
            if (from_light + least[j] > worst) break;
            const double distance = from_light + apart[j];
            const int32_t number = row[view.order[j]];
            if (number < 0 || distance > worst || (distance == worst && number > found[want - 1])) continue;
            int64_t at = have < want ? have++ : want - 1;
            for (; at > 0 && (best[at - 1] > distance || (best[at - 1] == distance && found[at - 1] > number)); at--)
                best[at] = best[at - 1], found[at] = found[at - 1];
            best[at] = distance, found[at] = number;
            if (have == want) worst = best[want - 1];
        }
    }
}

// The same of many queries at once, without a branch, where it is certain: of each side the AHEAD nearest are put in order, and
// of their pairs those that can be among the nearest. A key is a distance in coarse whole numbers, which are at most 1 too small,
// and what is that far away; keys of pairs are sums of two, and at most 2 too small.
enum { AHEAD = 10, NUMBERS = 65536 };
#define COARSE (1.0 / 32768)
#define FAR_AWAY 9e15
static const int ACROSS[AHEAD] = {10, 10, 8, 6, 4, 4, 3, 3, 2, 2};  // views that are paired with each light in this order

// Put keys into lists in ascending order; what falls off the end is lost.
static inline __attribute__((always_inline)) void put(double best[][TOGETHER], int levels, const double *key) {
    for (int i = 0; i < TOGETHER; i++) {
        double carry = key[i];
        for (int k = 0; k < levels; k++) {
            const double own = best[k][i], low = own < carry ? own : carry, high = own > carry ? own : carry;
            best[k][i] = low, carry = high;
        }
    }
}

// Put the AHEAD nearest of one side in order, as distances and numbers; `beyond` is what all others have at least.
static void ahead(
    const Side *side, const double *x, const double *y, double far[AHEAD][TOGETHER], int32_t number[AHEAD][TOGETHER], double *beyond
) {
    double key[AHEAD][TOGETHER], best[AHEAD][TOGETHER];
    const int64_t count = side->count < AHEAD ? side->count : AHEAD;
    for (int k = 0; k < AHEAD; k++)
        for (int i = 0; i < TOGETHER; i++) key[k][i] = best[k][i] = FAR_AWAY;
    for (int i = 0; i < TOGETHER; i++) {
        const Around of = around(side, x[i], y[i]);
        for (int64_t k = 0; k < count; k++) key[k][i] = floor(distance_of(&of, k) * COARSE) * NUMBERS + of.order[k];
        beyond[i] = side->count > AHEAD ? floor(at_least(&of, AHEAD) * COARSE) : FAR_AWAY;
    }
    for (int k = 0; k < AHEAD; k++) put(best, AHEAD, key[k]);
    for (int k = 0; k < AHEAD; k++)
        for (int i = 0; i < TOGETHER; i++) {
            far[k][i] = floor(best[k][i] / NUMBERS);
            number[k][i] = best[k][i] < FAR_AWAY ? (int32_t)(best[k][i] - far[k][i] * NUMBERS) : 0;
        }
}

// Find the NEAR nearest of each query [x y of light, x y of view], and which of the queries are certain.
static void nearest_of_many(
    const Side *lights, const Side *views, const int32_t *sample, double query[4][TOGETHER], int32_t found[NEAR][TOGETHER], int32_t *certain
) {
    double light[AHEAD][TOGETHER], view[AHEAD + 1][TOGETHER], beyond[TOGETHER], key[TOGETHER], best[NEAR + 1][TOGETHER];
    int32_t of_light[AHEAD][TOGETHER], of_view[AHEAD][TOGETHER];
    const int32_t wide = (int32_t)views->count;
    ahead(lights, query[0], query[1], light, of_light, beyond);
    ahead(views, query[2], query[3], view, of_view, view[AHEAD]);
    for (int i = 0; i < TOGETHER; i++) beyond[i] += view[0][i];
    for (int k = 0; k <= NEAR; k++)
        for (int i = 0; i < TOGETHER; i++) best[k][i] = FAR_AWAY;
    for (int a = 0; a < AHEAD; a++) {
        int32_t row[TOGETHER], number[TOGETHER];
        for (int i = 0; i < TOGETHER; i++) row[i] = of_light[a][i] * wide;
        for (int b = 0; b < ACROSS[a]; b++) {
#pragma omp simd
            for (int i = 0; i < TOGETHER; i++) number[i] = sample[row[i] + of_view[b][i]];
#pragma omp simd
            for (int i = 0; i < TOGETHER; i++) {
                const double sum = (light[a][i] + view[b][i]) * NUMBERS + number[i];
                key[i] = number[i] < 0 ? FAR_AWAY : sum;
            }
            put(best, NEAR + 1, key);
        }
#pragma omp simd
        for (int i = 0; i < TOGETHER; i++) {
            const double left = light[a][i] + view[ACROSS[a]][i];
            beyond[i] = left < beyond[i] ? left : beyond[i];
        }
    }
    for (int i = 0; i < TOGETHER; i++) {
        const double last = floor(best[NEAR - 1][i] / NUMBERS), next = floor(best[NEAR][i] / NUMBERS);
        certain[i] = (last + 2 <= next) & (last + 2 <= beyond[i]) & (best[NEAR - 1][i] < FAR_AWAY);
    }
    for (int k = 0; k < NEAR; k++)
        for (int i = 0; i < TOGETHER; i++) found[k][i] = (int32_t)(best[k][i] - floor(best[k][i] / NUMBERS) * NUMBERS);
}

// Solve a symmetric system of four [10 entries by rows of the lower half] of each query, in place of its right side.
static inline void NAME(solve)(REAL m[10][TOGETHER], REAL x[4][TOGETHER]) {
    for (int i = 0; i < TOGETHER; i++) {
        const REAL a = 1 / m[0][i], l10 = m[1][i] * a, l20 = m[3][i] * a, l30 = m[6][i] * a;
        const REAL b = 1 / (m[2][i] - l10 * m[1][i]);
        const REAL u21 = m[4][i] - l20 * m[1][i], l21 = u21 * b, u31 = m[7][i] - l30 * m[1][i], l31 = u31 * b;
        const REAL c = 1 / (m[5][i] - l20 * m[3][i] - l21 * u21);
        const REAL u32 = m[8][i] - l30 * m[3][i] - l31 * u21, l32 = u32 * c;
        const REAL d = 1 / (m[9][i] - l30 * m[6][i] - l31 * u31 - l32 * u32);
        const REAL y0 = x[0][i], y1 = x[1][i] - l10 * y0, y2 = x[2][i] - l20 * y0 - l21 * y1;
        const REAL y3 = x[3][i] - l30 * y0 - l31 * y1 - l32 * y2;
        const REAL z3 = y3 * d, z2 = y2 * c - l32 * z3, z1 = y1 * b - l21 * z2 - l31 * z3;
        x[0][i] = y0 * a - l10 * z1 - l20 * z2 - l30 * z3;
        x[1][i] = z1, x[2][i] = z2, x[3][i] = z3;
    }
}

// The weights [want] of neighbours at `point` about `query`: by distance, and for a plane through them.
APART void NAME(weigh)(int64_t want, REAL query[4][TOGETHER], REAL point[NEAR][4][TOGETHER], REAL near[NEAR][TOGETHER]) {
    REAL scale[TOGETHER], sum[TOGETHER], mean[4][TOGETHER], moment[10][TOGETHER], slope[4][TOGETHER];
    for (int i = 0; i < TOGETHER; i++) scale[i] = (REAL)1e-12, sum[i] = 0;
    for (int64_t k = 0; k < want; k++)
        for (int i = 0; i < TOGETHER; i++) {
            REAL squared = 0;
            for (int d = 0; d < 4; d++) squared += (query[d][i] - point[k][d][i]) * (query[d][i] - point[k][d][i]);
            near[k][i] = squared;
            scale[i] = squared > scale[i] ? squared : scale[i];
        }
    for (int64_t k = 0; k < want; k++)
        for (int i = 0; i < TOGETHER; i++) {
            const REAL share = near[k][i] / scale[i];
            near[k][i] = (1 - (REAL)0.999 * share) / (share + (REAL)1e-7);
            sum[i] += near[k][i];
        }
    memset(mean, 0, sizeof mean);
    for (int d = 0; d < 4; d++)
        for (int i = 0; i < TOGETHER; i++) slope[d][i] = point[0][d][i] - query[d][i];
    for (int64_t k = want - 1; k >= 0; k--) {
        for (int i = 0; i < TOGETHER; i++) near[k][i] /= sum[i];
        for (int d = 0; d < 4; d++)
            for (int i = 0; i < TOGETHER; i++) {
                point[k][d][i] -= point[0][d][i];
                mean[d][i] += near[k][i] * point[k][d][i];
            }
    }
    memset(moment, 0, sizeof moment);
    for (int64_t k = 0; k < want; k++) {
        for (int d = 0; d < 4; d++)
            for (int i = 0; i < TOGETHER; i++) point[k][d][i] -= mean[d][i];
        for (int a = 0, at = 0; a < 4; a++)
            for (int b = 0; b <= a; b++, at++)
                for (int i = 0; i < TOGETHER; i++) moment[at][i] += near[k][i] * point[k][a][i] * point[k][b][i];
    }
    for (int i = 0; i < TOGETHER; i++) {
        const REAL trace = moment[0][i] + moment[2][i] + moment[5][i] + moment[9][i];
        const REAL damping = (REAL)0.05 * trace + (REAL)1e-6 * scale[i];
        moment[0][i] += damping, moment[2][i] += damping, moment[5][i] += damping, moment[9][i] += damping;
        for (int d = 0; d < 4; d++) slope[d][i] += mean[d][i];
    }
    NAME(solve)(moment, slope);
    for (int64_t k = 0; k < want; k++)
        for (int i = 0; i < TOGETHER; i++)
            near[k][i] *= 1 - (point[k][0][i] * slope[0][i] + point[k][1][i] * slope[1][i] + point[k][2][i] * slope[2][i]
                               + point[k][3][i] * slope[3][i]);
}

// For queries [count, 4] of light x, y and view x, y: the numbers of the `want` nearest of `known` [., 4], and their weights.
void NAME(neighbours)(
    const REAL *known, const REAL *queries, const double *light_places, const double *light_away, const int32_t *light_order,
    const double *view_places, const double *view_away, const int32_t *view_order, const int32_t *sample, int32_t *index, REAL *weight,
    int64_t lights, int64_t views, int64_t count, int64_t want, int64_t threads
) {
    const Side light = {light_places, light_away, light_order, lights}, view = {view_places, view_away, view_order, views};
#pragma omp parallel for num_threads((int)threads) schedule(static)
    for (int64_t part = 0; part < (count + TOGETHER - 1) / TOGETHER; part++) {
        const int64_t first = part * TOGETHER, some = first + TOGETHER < count ? TOGETHER : count - first;
        REAL query[4][TOGETHER], point[NEAR][4][TOGETHER], near[NEAR][TOGETHER];
        double whole[4][TOGETHER];
        int32_t found[NEAR][TOGETHER], certain[TOGETHER] = {0};
        for (int64_t i = 0; i < TOGETHER; i++)  // what is beyond the last query is that one again
            for (int d = 0; d < 4; d++) {
                query[d][i] = queries[4 * (first + (i < some ? i : some - 1)) + d];
                whole[d][i] = rint(query[d][i] * ONE);
            }
        if (want == NEAR) nearest_of_many(&light, &view, sample, whole, found, certain);
        for (int64_t i = 0; i < some; i++) {
            int32_t *own = index + (first + i) * want;
            const double place[4] = {whole[0][i], whole[1][i], whole[2][i], whole[3][i]};
            if (!certain[i]) nearest(&light, &view, sample, place, want, own);
            for (int64_t k = 0; k < want; k++) {
                if (certain[i]) own[k] = found[k][i];
                for (int d = 0; d < 4; d++) point[k][d][i] = known[4 * own[k] + d];
            }
        }
        for (int64_t i = some; i < TOGETHER; i++)
            for (int64_t k = 0; k < want; k++)
                for (int d = 0; d < 4; d++) point[k][d][i] = point[k][d][some - 1];
        NAME(weigh)(want, query, point, near);
        for (int64_t i = 0; i < some; i++)
            for (int64_t k = 0; k < want; k++) weight[(first + i) * want + k] = near[k][i];
    }
}

// PCA's value as it is shown [count, 3, texels]: `index` and `share` [count, texels, want] pick rows of `table` [., factors], which holds
// the terms and zeros up to a multiple of EIGHT.
void NAME(components)(
    const REAL *light, const REAL *view, const int32_t *index, const REAL *share, const REAL *table, const REAL *layers, REAL *out,
    int64_t lights, int64_t light_places, int64_t views, int64_t view_places, int64_t count, int64_t texels, int64_t want,
    int64_t terms, int64_t factors, int64_t threads
) {
    const NAME(Directions) lit = {light, lights, light_places}, seen = {view, views, view_places};
#pragma omp parallel for num_threads((int)threads) schedule(static)
    for (int64_t part = 0; part < (texels + BLOCK - 1) / BLOCK; part++) {
        const int64_t first = part * BLOCK, some = first + BLOCK < texels ? BLOCK : texels - first;
        REAL light_room[3][BLOCK], view_room[3][BLOCK], weight[MOST_FACTORS][BLOCK], total[3][BLOCK];
        for (int64_t number = 0; number < count; number++) {
            for (int64_t i = 0; i < some; i++) {
                const int64_t at = (number * texels + first + i) * want;
                for (int64_t from = 0; from < factors; from += EIGHT) {
                    NAME(eight) row = {0};
                    for (int64_t k = 0; k < want; k++)
                        row += share[at + k] * *(const NAME(eight) *)(table + index[at + k] * factors + from);
                    for (int j = 0; j < EIGHT; j++) weight[from + j][i] = row[j];
                }
            }
            const REAL *l[3], *v[3];
            NAME(along)(&lit, number, first, some, light_room, l);
            NAME(along)(&seen, number, first, some, view_room, v);
            NAME(combine)(weight, layers + first, terms, 3, texels, some, total);
            for (int c = 0; c < 3; c++) NAME(show)(total[c], l[2], v[2], some, out + (3 * number + c) * texels + first);
        }
    }
}
