/* Many runs, which several threads share. This text stands behind that of call.c. Widths: bytes of one run in each array. */
typedef struct {
    Function function;
    int64_t workspace, n_in, n_out, lanes, runs;
    char **in, **out;
    int64_t *width_in, *width_out;
    int64_t next;
    int failed;
} Batch;

static void *run_batch(void *pointer)
{
    Batch *b = pointer;
    void **in = malloc((size_t)(b->n_in + b->n_out + 1) * sizeof *in), *memory = new_workspace(b->workspace);
    if (!in || (b->workspace && !memory)) {
        __atomic_store_n(&b->failed, 1, __ATOMIC_RELEASE);
        free(in);
        free(memory);
        return NULL;
    }
    void **out = in + b->n_in;
    for (;;) {
        int64_t first = __atomic_fetch_add(&b->next, b->lanes, __ATOMIC_RELAXED);
        if (first >= b->runs)
            break;
        for (int64_t i = 0; i < b->n_in; i++)
            in[i] = b->in[i] + first * b->width_in[i];
        for (int64_t i = 0; i < b->n_out; i++)
            out[i] = b->out[i] + first * b->width_out[i];
        b->function((const void *const *)in, out, memory, (int32_t)(b->runs - first < b->lanes ? b->runs - first : b->lanes));
    }
    free(in);
    free(memory);
    return NULL;
}

/* 0, or 1 where there was not enough memory. */
int trimtab_batch(Batch *b, int64_t threads)
{
    pthread_t *others = threads > 1 ? malloc((size_t)(threads - 1) * sizeof *others) : NULL;
    int64_t started = 0;
    for (; others && started < threads - 1; started++)
        if (pthread_create(&others[started], NULL, run_batch, b))
            break;
    run_batch(b);
    while (started)
        pthread_join(others[--started], NULL);
    free(others);
    return b->failed;
}
