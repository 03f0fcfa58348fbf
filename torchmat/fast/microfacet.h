// The microfacet material's value as it is shown, without gradients, in one pass: models/microfacet.py.

#define GRAZING 1e-4

// Maps of `texels`, NULL for a part that is not there; roughness has one or two channels.
typedef struct {
    const REAL *diffuse, *f0, *roughness, *normal, *rotation, *f90, *coat, *coat_roughness, *sheen, *sheen_roughness, *rolloff;
    int64_t roughnesses, layered, texels;
} NAME(Surface);

// What the maps alone say of a block: tangent, bitangent and normal, squared alphas, F90 of the surface and of its coat.
typedef struct {
    REAL frame[3][3][BLOCK], squares[2][BLOCK], f90[BLOCK], coat_square[BLOCK], coat_f90[BLOCK];
    int64_t turned;
} NAME(Prepared);

// One sample of a block: directions in the texels' frames, cosines, and Schlick's rise.
typedef struct {
    REAL light[3][BLOCK], view[3][BLOCK], half[3][BLOCK], n_dot_l[BLOCK], n_dot_v[BLOCK], rise[BLOCK], share[BLOCK];
} NAME(Meeting);

static inline REAL NAME(squared_alpha)(REAL roughness) {
    const REAL square = roughness * roughness;
    return square * square + (REAL)1e-6;
}
static inline REAL NAME(fifth)(REAL apart) {
    const REAL square = apart * apart;
    return square * square * apart;
}
static inline REAL NAME(usual_f90)(REAL mean) { return 50 * mean > 1 ? 1 : 50 * mean; }

// Tangent and bitangent by the shortest turn of +z to the normal, and turned about it.
APART void NAME(make_frame)(const NAME(Surface) *of, int64_t first, int64_t some, REAL frame[3][3][BLOCK]) {
    memset(frame, 0, 9 * BLOCK * sizeof(REAL));
    for (int axis = 0; axis < 3; axis++)
        for (int64_t i = 0; i < some; i++) frame[axis][axis][i] = 1;
    if (of->normal) {
        const REAL *x = of->normal + first, *y = x + of->texels, *z = y + of->texels;
        NAME(normalised)(x, y, z, some, frame[2]);
        for (int64_t i = 0; i < some; i++) {
            const REAL x = frame[2][0][i], y = frame[2][1][i], shared = NAME(ratio)(1, 1 + frame[2][2][i]);
            frame[0][0][i] = 1 - x * x * shared, frame[0][1][i] = frame[1][0][i] = -x * y * shared, frame[0][2][i] = -x;
            frame[1][1][i] = 1 - y * y * shared, frame[1][2][i] = -y;
        }
    }
    if (!of->rotation) return;
    REAL turn[3][BLOCK] = {0};
    NAME(normalised)(of->rotation + first, of->rotation + of->texels + first, turn[2], some, turn);
    for (int64_t i = 0; i < some; i++) {
        const REAL sine = turn[1][i], cosine = (turn[0][i] == 0) & (sine == 0) ? 1 : turn[0][i];
        for (int axis = 0; axis < 3; axis++) {
            const REAL t = frame[0][axis][i], b = frame[1][axis][i];
            frame[0][axis][i] = cosine * t + sine * b, frame[1][axis][i] = cosine * b - sine * t;
        }
    }
}

APART void NAME(prepare)(const NAME(Surface) *of, int64_t first, int64_t some, NAME(Prepared) *to) {
    to->turned = of->normal || of->rotation;
    if (to->turned) NAME(make_frame)(of, first, some, to->frame);
    const REAL *rough = of->roughness + first, *across = rough + (of->roughnesses - 1) * of->texels, *f0 = of->f0 + first;
    for (int64_t i = 0; i < some; i++) {
        to->squares[0][i] = NAME(squared_alpha)(rough[i]), to->squares[1][i] = NAME(squared_alpha)(across[i]);
        to->f90[i] = NAME(usual_f90)((f0[i] + f0[of->texels + i] + f0[2 * of->texels + i]) / 3);
    }
    if (of->f90)
        for (int64_t i = 0; i < some; i++) to->f90[i] *= of->f90[first + i];
    if (of->coat)
        for (int64_t i = 0; i < some; i++) {
            to->coat_square[i] = NAME(squared_alpha)(of->coat_roughness[first + i]);
            to->coat_f90[i] = NAME(usual_f90)(of->coat[first + i]);
        }
}

static inline void NAME(into_frame)(const NAME(Prepared) *by, const REAL *direction[3], int64_t some, REAL to[3][BLOCK]) {
    for (int axis = 0; axis < 3; axis++) {
        if (!by->turned) {
            memcpy(to[axis], direction[axis], some * sizeof(REAL));
            continue;
        }
        for (int64_t i = 0; i < some; i++)
            to[axis][i] = direction[0][i] * by->frame[axis][0][i] + direction[1][i] * by->frame[axis][1][i]
                          + direction[2][i] * by->frame[axis][2][i];
    }
}

APART void NAME(meet)(const NAME(Prepared) *by, const REAL *light[3], const REAL *view[3], int64_t some, NAME(Meeting) *to) {
    REAL half[3][BLOCK];
    const REAL *halves[3] = {half[0], half[1], half[2]};
    for (int64_t i = 0; i < some; i++) {
        const REAL x = light[0][i] + view[0][i], y = light[1][i] + view[1][i], z = light[2][i] + view[2][i];
        const REAL squared = NAME(above)(x * x + y * y + z * z, (REAL)1e-24), length = SQRT(squared), shrink = 1 / length;
        half[0][i] = x * shrink, half[1][i] = y * shrink, half[2][i] = z * shrink;
        to->rise[i] = NAME(fifth)(NAME(above)(1 - length / 2, 0));
    }
    NAME(into_frame)(by, light, some, to->light);
    NAME(into_frame)(by, view, some, to->view);
    NAME(into_frame)(by, halves, some, to->half);
    for (int64_t i = 0; i < some; i++)
        to->n_dot_l[i] = NAME(above)(to->light[2][i], 0), to->n_dot_v[i] = NAME(above)(to->view[2][i], 0);
}

// The lobe without its Fresnel term, of squared alphas along and across.
APART void NAME(ggx)(const NAME(Meeting) *of, const REAL *along, const REAL *across, int64_t some, REAL *share) {
    const REAL least = (REAL)1e-12;
    for (int64_t i = 0; i < some; i++) {
        const REAL u = along[i], v = across[i], x = of->half[0][i], y = of->half[1][i], z = of->half[2][i];
        const REAL lx = of->light[0][i], ly = of->light[1][i], lz = of->light[2][i];
        const REAL vx = of->view[0][i], vy = of->view[1][i], vz = of->view[2][i];
        const REAL light = SQRT(NAME(above)(lz * lz + lx * lx * u + ly * ly * v, least));
        const REAL view = SQRT(NAME(above)(vz * vz + vx * vx * u + vy * vy * v, least));
        const REAL denominator = of->n_dot_l[i] * view + of->n_dot_v[i] * light + (REAL)GRAZING, slope = z * z + x * x / u + y * y / v;
        share[i] = of->n_dot_l[i] / (slope * slope * SQRT(u * v) * 2 * denominator);
    }
}

// What gets through a layer both ways: 1 - F of either cosine.
static inline REAL NAME(through)(REAL f0, REAL f90, REAL n_dot_l, REAL n_dot_v) {
    const REAL one = NAME(above)(1 - f0 - (f90 - f0) * NAME(fifth)(1 - n_dot_l), 0);
    return one * NAME(above)(1 - f0 - (f90 - f0) * NAME(fifth)(1 - n_dot_v), 0);
}

static inline REAL NAME(rolled)(const REAL *by, REAL cosine) {
    return NAME(above)(1 + by[0] * (1 - cosine) + by[1] * NAME(fifth)(1 - cosine), 0);
}

// Surface and base: diffuse and specular part of one channel.
APART void NAME(base)(
    const NAME(Surface) *of, const NAME(Prepared) *by, const NAME(Meeting) *met, const REAL *f0, const REAL *diffuse, int64_t some, REAL *to
) {
    REAL lit[BLOCK];
    memcpy(lit, met->n_dot_l, some * sizeof(REAL));
    if (of->rolloff)
        for (int64_t i = 0; i < some; i++)
            lit[i] *= NAME(rolled)(of->rolloff, met->n_dot_l[i]) * NAME(rolled)(of->rolloff, met->n_dot_v[i]);
    if (of->layered && !of->coat)
        for (int64_t i = 0; i < some; i++) lit[i] *= NAME(through)(f0[i], by->f90[i], met->n_dot_l[i], met->n_dot_v[i]);
    for (int64_t i = 0; i < some; i++)
        to[i] = met->share[i] * (met->rise[i] * by->f90[i]) + met->share[i] * (1 - met->rise[i]) * f0[i] + diffuse[i] * lit[i];
}

// What a coat and fibres add on top, the coat the same to all channels.
APART void NAME(add_coat)(
    const NAME(Surface) *of, const NAME(Prepared) *by, const NAME(Meeting) *met, int64_t first, int64_t some, REAL total[3][BLOCK]
) {
    REAL share[BLOCK];
    NAME(ggx)(met, by->coat_square, by->coat_square, some, share);
    for (int c = 0; c < 3; c++)
        for (int64_t i = 0; i < some; i++) {
            const REAL f0 = of->coat[first + i], f90 = by->coat_f90[i];
            const REAL kept = of->layered ? NAME(through)(f0, f90, met->n_dot_l[i], met->n_dot_v[i]) : 1;
            total[c][i] = total[c][i] * kept + share[i] * (f0 + (f90 - f0) * met->rise[i]);
        }
}

APART void NAME(add_sheen)(const NAME(Surface) *of, const NAME(Meeting) *met, int64_t first, int64_t some, REAL total[3][BLOCK]) {
    const REAL exponent = 1 / (of->sheen_roughness[0] * of->sheen_roughness[0]);
    REAL fibres[BLOCK];
    for (int64_t i = 0; i < some; i++) {
        const REAL x = met->half[0][i], y = met->half[1][i], l = met->n_dot_l[i], v = met->n_dot_v[i];
        fibres[i] = (2 + exponent) / 8 * NAME(power)(x * x + y * y, exponent / 2) * l / (l + v - l * v + (REAL)GRAZING);
    }
    for (int c = 0; c < 3; c++)
        for (int64_t i = 0; i < some; i++) total[c][i] += of->sheen[c * of->texels + first + i] * fibres[i];
}

// The value [count, 3, texels].
void NAME(microfacet)(
    const REAL *light, const REAL *view, const REAL *diffuse, const REAL *f0, const REAL *roughness, const REAL *normal,
    const REAL *rotation, const REAL *f90, const REAL *coat, const REAL *coat_roughness, const REAL *sheen, const REAL *sheen_roughness,
    const REAL *rolloff, REAL *out, int64_t lights, int64_t light_places, int64_t views, int64_t view_places, int64_t count,
    int64_t texels, int64_t roughnesses, int64_t layered, int64_t threads
) {
    const NAME(Directions) lit = {light, lights, light_places}, seen = {view, views, view_places};
    const NAME(Surface) surface = {
        diffuse, f0, roughness, normal, rotation, f90, coat, coat_roughness, sheen, sheen_roughness, rolloff, roughnesses, layered, texels,
    };
#pragma omp parallel for num_threads((int)threads) schedule(static)
    for (int64_t part = 0; part < (texels + BLOCK - 1) / BLOCK; part++) {
        const int64_t first = part * BLOCK, some = first + BLOCK < texels ? BLOCK : texels - first;
        REAL light_room[3][BLOCK], view_room[3][BLOCK], total[3][BLOCK];
        NAME(Prepared) prepared;
        NAME(Meeting) met;
        NAME(prepare)(&surface, first, some, &prepared);
        for (int64_t number = 0; number < count; number++) {
            const REAL *l[3], *v[3];
            NAME(along)(&lit, number, first, some, light_room, l);
            NAME(along)(&seen, number, first, some, view_room, v);
            NAME(meet)(&prepared, l, v, some, &met);
            NAME(ggx)(&met, prepared.squares[0], prepared.squares[1], some, met.share);
            for (int64_t c = 0; c < 3; c++)
                NAME(base)(&surface, &prepared, &met, f0 + c * texels + first, diffuse + c * texels + first, some, total[c]);
            if (coat) NAME(add_coat)(&surface, &prepared, &met, first, some, total);
            if (sheen) NAME(add_sheen)(&surface, &met, first, some, total);
            for (int c = 0; c < 3; c++) NAME(show)(total[c], l[2], v[2], some, out + (3 * number + c) * texels + first);
        }
    }
}
