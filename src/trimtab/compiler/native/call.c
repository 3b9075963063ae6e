/* A compiled function as a Python callable: allocate memory and build the results. This text follows that of
 * arguments.c and batch.c. */
static PyObject *give(const Program *p, const Node **node, PyObject ***results)
{
    const Node *n = (*node)++;
    if (n->kind == LEAF) {
        PyObject *result = *(*results)++;
        Py_IncRef(result);
        return result;
    }
    if (n->kind == NOTHING) {
        Py_IncRef(p->none);
        return p->none;
    }
    PyObject *made = n->kind == TUPLE || n->kind == NAMED ? PyTuple_New(n->count) : n->kind == LIST ? PyList_New(n->count) : PyDict_New();
    for (int64_t i = 0; made && i < n->count; i++) {
        PyObject *child = give(p, node, results);
        if (!child) {
            Py_DecRef(made);
            return NULL;
        }
        if (n->kind == TUPLE || n->kind == NAMED)
            PyTuple_SetItem(made, i, child);
        else if (n->kind == LIST)
            PyList_SetItem(made, i, child);
        else {
            PyDict_SetItem(made, n->keys[i], child);
            Py_DecRef(child);
        }
    }
    if (made && n->kind == NAMED) {
        PyObject *parts = made;
        made = PyObject_CallObject(n->type, parts);
        Py_DecRef(parts);
    }
    return made;
}

static PyObject *give_all(const Program *p, PyObject **results)
{
    if (!p->assemble) {
        const Node *node = p->gives;
        return give(p, &node, &results);
    }
    PyObject *flat = PyTuple_New(p->n_out), *one = PyTuple_New(1), *tree = NULL;
    if (flat && one) {
        for (int64_t i = 0; i < p->n_out; i++) {
            Py_IncRef(results[i]);
            PyTuple_SetItem(flat, i, results[i]);
        }
        PyTuple_SetItem(one, 0, flat);
        tree = PyObject_CallObject(p->assemble, one);
        Py_DecRef(one);
    }
    return tree;
}

static void *borrow_workspace(Program *p)
{
    void *memory = p->workspace ? __atomic_exchange_n(&p->spare, NULL, __ATOMIC_ACQ_REL) : NULL;
    return memory ? memory : new_workspace(p->workspace);
}

static void return_workspace(Program *p, void *memory)
{
    if (memory)
        free(__atomic_exchange_n(&p->spare, memory, __ATOMIC_ACQ_REL));
}

/* Maximum number of arguments or results whose pointers are on the stack. */
enum { FEW = 32 };

/* Return `few` if it has room for `count` elements, else new memory of `count` times `each` bytes. Without memory, set
 * an error and return NULL. */
static void *room(int64_t count, size_t each, void *few)
{
    void *memory = count <= FEW ? few : malloc((size_t)count * each);
    if (!memory)
        PyErr_NoMemory();
    return memory;
}

static void leave(void *memory, void *few)
{
    if (memory != few)
        free(memory);
}

/* Return a new array for a result, or for that result in many runs. */
static PyObject *new_result(const Program *p, const Leaf *leaf, int64_t runs)
{
    if (!p->lanes)
        return PyObject_CallObject(p->empty, leaf->empty);
    PyObject *arguments = PyTuple_New(2), *shape = PyTuple_New(leaf->axes + 1), *made = NULL;
    if (arguments && shape) {
        for (int64_t i = 0; i <= leaf->axes; i++)
            PyTuple_SetItem(shape, i, PyLong_FromLongLong(i ? leaf->shape[i - 1] : runs));
        Py_IncRef(leaf->type);
        PyTuple_SetItem(arguments, 0, shape);
        PyTuple_SetItem(arguments, 1, leaf->type);
        made = PyObject_CallObject(p->empty, arguments);
        Py_DecRef(arguments);
    }
    return made;
}

static PyObject *run_into(Program *p, Taking *t, PyObject **results, void **out)
{
    PyObject *made = NULL;
    int64_t ready = 0;
    for (; ready < p->n_out; ready++) {
        results[ready] = new_result(p, &p->out[ready], t->runs);
        if (!results[ready])
            break;
        out[ready] = ((Array *)results[ready])->data;
    }
    bool many = p->lanes;
    void *memory = ready == p->n_out && !many ? borrow_workspace(p) : NULL;
    if (ready == p->n_out && many) {
        void *state = PyEval_SaveThread();
        bool good = run_many(p, t->in, t->once, t->shared, out, t->runs);
        PyEval_RestoreThread(state);
        made = good ? give_all(p, results) : PyErr_NoMemory();
    } else if (ready == p->n_out && p->workspace && !memory) {
        PyErr_NoMemory();
    } else if (ready == p->n_out) {
        void *state = PyEval_SaveThread();
        p->function(t->in, out, memory, 1);
        PyEval_RestoreThread(state);
        return_workspace(p, memory);
        made = give_all(p, results);
    }
    while (ready)
        Py_DecRef(results[--ready]);
    return made;
}

static PyObject *run(Program *p, Taking *t)
{
    struct {
        PyObject *results[FEW];
        void *out[FEW];
    } few;
    char *memory = room(p->n_out, sizeof(PyObject *) + sizeof(void *), &few);
    if (!memory)
        return NULL;
    int64_t most = p->n_out > FEW ? p->n_out : FEW;
    PyObject **results = (PyObject **)memory;
    PyObject *made = run_into(p, t, results, (void **)(results + most));
    leave(memory, &few);
    return made;
}

static PyObject *call(PyObject *self, PyObject *const *arguments, Py_ssize_t count)
{
    Program *p = PyCapsule_GetPointer(self, NULL);
    struct {
        const void *in[FEW];
        PyObject *held[FEW];
        Number numbers[FEW];
        View views[FEW];
        char once[FEW];
    } few;
    char *memory = room(p->n_in, sizeof few / FEW, &few);
    if (!memory)
        return NULL;
    int64_t most = p->n_in > FEW ? p->n_in : FEW;
    const void **in = (const void **)memory;
    PyObject **held = (PyObject **)(in + most);
    memset(held, 0, (size_t)p->n_in * sizeof *held);
    Number *numbers = (Number *)(held + most);
    View *views = (View *)(numbers + most);
    Taking t = {p, p->takes + 1, 0, -1, 0, 0, in, held, numbers, (char *)(views + most), views};
    bool good = count == p->takes[0].count;
    for (Py_ssize_t i = 0; good && i < count; i++)
        good = take(&t, arguments[i]);
    good = good && (!p->lanes || t.runs >= 0);
    good = good || take_normalised(&t, arguments, count);
    PyObject *made = good ? run(p, &t) : NULL;
    let_go(&t);
    leave(memory, &few);
    return made;
}

static PyMethodDef definition = {"compiled", call, 0x80, "A function compiled by trimtab."};

static void end(PyObject *capsule)
{
    Program *p = PyCapsule_GetPointer(capsule, NULL);
    free(p->spare);
}

/* Return a callable of this program. kept: objects that must live as long as the callable. */
PyObject *trimtab_callable(Program *p, PyObject *kept)
{
    PyObject *capsule = PyCapsule_New(p, NULL, end);
    PyObject *made = capsule ? PyCFunction_NewEx(&definition, capsule, kept) : NULL;
    if (capsule)
        Py_DecRef(capsule);
    return made;
}

/* True if numpy's arrays and scalars have the memory layout that this text assumes. */
int trimtab_knows_arrays(
    PyObject *array, PyObject *array_type, PyObject *type, void *data, int64_t rows, int64_t columns, PyObject *pi)
{
    const Array *a = (const Array *)array;
    double behind;
    memcpy(&behind, (char *)pi + HEAD, sizeof behind);
    return behind == 3.141592653589793 && type_of(array) == array_type && a->type == type && a->data == data && a->axes == 2 && a->shape[0] == rows
        && a->shape[1] == columns && (a->flags & NATIVE_AND_ALIGNED) == NATIVE_AND_ALIGNED;
}
