/* Many runs, which several threads share. This text follows that of arguments.c. */
typedef struct {
    const Program *p;
    const void *const *in;
    void *const *out;
    int64_t runs, next;
    int failed;
} Batch;

static void *new_workspace(int64_t bytes)
{
    void *memory = NULL;
    return bytes && !posix_memalign(&memory, 64, (size_t)bytes) ? memory : NULL;
}

static void *run_some(void *pointer)
{
    Batch *b = pointer;
    const Program *p = b->p;
    void **in = malloc((size_t)(p->n_in + p->n_out + 1) * sizeof *in), *memory = new_workspace(p->workspace);
    if (!in || (p->workspace && !memory)) {
        __atomic_store_n(&b->failed, 1, __ATOMIC_RELEASE);
        free(in);
        free(memory);
        return NULL;
    }
    void **out = in + p->n_in;
    for (;;) {
        int64_t first = __atomic_fetch_add(&b->next, p->lanes, __ATOMIC_RELAXED), left = b->runs - first;
        if (left <= 0)
            break;
        for (int64_t i = 0; i < p->n_in; i++)
            in[i] = (char *)b->in[i] + first * p->in[i].width;
        for (int64_t i = 0; i < p->n_out; i++)
            out[i] = (char *)b->out[i] + first * p->out[i].width;
        p->function((const void *const *)in, out, memory, (int32_t)(left < p->lanes ? left : p->lanes));
    }
    free(in);
    free(memory);
    return NULL;
}

/* Run all runs, in at most as many threads as have work. Return false if there was not enough memory. */
static bool run_batch(Batch *b)
{
    int64_t threads = (b->runs + b->p->lanes - 1) / b->p->lanes;
    if (threads > b->p->threads)
        threads = b->p->threads;
    pthread_t *others = threads > 1 ? malloc((size_t)(threads - 1) * sizeof *others) : NULL;
    int64_t started = 0;
    for (; others && started < threads - 1; started++)
        if (pthread_create(&others[started], NULL, run_some, b))
            break;
    run_some(b);
    while (started)
        pthread_join(others[--started], NULL);
    free(others);
    return !b->failed;
}

/* Maximum bytes of the copies of one array. */
#define MOST_COPIED ((int64_t)1 << 46)

/* Run all runs. Arrays that the runs share (marked in `once`) are copied for each run. Return false without memory. */
static bool run_many(const Program *p, const void **in, const char *once, int64_t shared, void *const *out, int64_t runs)
{
    int64_t bytes = 0, at = 0;
    for (int64_t i = 0; shared && i < p->n_in; i++) {
        if (once[i] && p->in[i].width && runs > MOST_COPIED / p->in[i].width)
            return false;
        bytes += once[i] ? (p->in[i].width * runs + 63) / 64 * 64 : 0;
    }
    char *copies = new_workspace(bytes);
    if (bytes && !copies)
        return false;
    for (int64_t i = 0; bytes && i < p->n_in; i++)
        if (once[i]) {
            for (int64_t k = 0; k < runs; k++)
                memcpy(copies + at + k * p->in[i].width, in[i], (size_t)p->in[i].width);
            in[i] = copies + at;
            at += (p->in[i].width * runs + 63) / 64 * 64;
        }
    Batch b = {p, in, out, runs, 0, 0};
    bool good = run_batch(&b);
    free(copies);
    return good;
}
