/* A compiled function as a callable of Python: arguments checked and taken apart, memory found, results put together.
 *
 * What is used of Python is its stable ABI, declared here, so that no headers are needed; of numpy's arrays the layout
 * that its ABI fixes. HEAD, the size of an object's head, stands before this text. */
#include <pthread.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

typedef ptrdiff_t Py_ssize_t;
typedef struct PyObject PyObject;
typedef PyObject *(*Fast)(PyObject *self, PyObject *const *arguments, Py_ssize_t count);
typedef struct {
    const char *name;
    Fast function;
    int flags;
    const char *doc;
} PyMethodDef;

PyObject *PyCapsule_New(void *pointer, const char *name, void (*end)(PyObject *));
void *PyCapsule_GetPointer(PyObject *capsule, const char *name);
PyObject *PyCFunction_NewEx(PyMethodDef *definition, PyObject *self, PyObject *module);
PyObject *PyDict_GetItem(PyObject *dict, PyObject *key);
PyObject *PyDict_New(void);
int PyDict_SetItem(PyObject *dict, PyObject *key, PyObject *value);
Py_ssize_t PyDict_Size(PyObject *dict);
void PyErr_Clear(void);
PyObject *PyErr_NoMemory(void);
PyObject *PyErr_Occurred(void);
void *PyEval_SaveThread(void);
void PyEval_RestoreThread(void *state);
double PyFloat_AsDouble(PyObject *number);
PyObject *PyList_GetItem(PyObject *list, Py_ssize_t i);
PyObject *PyList_New(Py_ssize_t size);
int PyList_SetItem(PyObject *list, Py_ssize_t i, PyObject *item);
Py_ssize_t PyList_Size(PyObject *list);
long long PyLong_AsLongLong(PyObject *number);
PyObject *PyObject_CallObject(PyObject *callable, PyObject *arguments);
PyObject *PyObject_GetAttr(PyObject *object, PyObject *name);
PyObject *PyTuple_GetItem(PyObject *tuple, Py_ssize_t i);
PyObject *PyTuple_New(Py_ssize_t size);
int PyTuple_SetItem(PyObject *tuple, Py_ssize_t i, PyObject *item);
Py_ssize_t PyTuple_Size(PyObject *tuple);
void Py_DecRef(PyObject *object);
void Py_IncRef(PyObject *object);

/* A place in a tree, in the order in which it is walked. */
enum { LEAF, TUPLE, LIST, DICT, NOTHING, RECORD };
typedef struct {
    int64_t kind, count;
    PyObject *type;  /* borrowed, as all objects here: `kept` holds them */
    PyObject **keys; /* of a dict, or names of fields */
} Node;

/* An array. If it has no axes: scalar: numpy's class of such numbers, else NULL; numbers: which of Python's numbers it
 * takes: 'd', 'f', 'l', 'i', '?' or 0. */
typedef struct {
    PyObject *type, *scalar;
    int64_t axes, numbers;
    int64_t *shape;
    PyObject *empty; /* arguments of numpy.empty */
} Leaf;

typedef void (*Function)(const void *const *in, void *const *out, void *workspace, int32_t runs);

typedef struct {
    Function function;
    int64_t workspace, n_in, n_out;
    Leaf *in, *out;
    Node *takes, *gives;
    PyObject *array, *python_float, *python_int, *python_bool, *empty, *none;
    PyObject *normalise; /* (all arguments) -> flat tuple of arrays as they must be; raises */
    PyObject *assemble;  /* (flat results) -> tree, or NULL where `gives` tells all */
    void *spare;         /* a workspace that no call uses now */
} Program;

typedef struct {
    char head[HEAD];
    char *data;
    int axes;
    Py_ssize_t *shape, *strides;
    PyObject *base, *type;
    int flags;
} Array;

enum { CONTIGUOUS = 1, ALIGNED = 0x100, NATIVE_AND_ALIGNED = CONTIGUOUS | ALIGNED };

typedef union {
    double d;
    float f;
    int64_t l;
    int32_t i;
    bool b;
} Number;

typedef struct {
    const Program *p;
    const Node *node;
    int64_t at;
    const void **in;
    PyObject **held;
    Number *numbers;
} Taking;

static PyObject *type_of(PyObject *o)
{
    return *(PyObject **)((char *)o + HEAD - sizeof(PyObject *));
}

static bool take_array(Taking *t, PyObject *o)
{
    const Leaf *leaf = &t->p->in[t->at];
    const Array *a = (const Array *)o;
    if (type_of(o) != t->p->array || a->type != leaf->type || a->axes != leaf->axes)
        return false;
    if ((a->flags & NATIVE_AND_ALIGNED) != NATIVE_AND_ALIGNED)
        return false;
    for (int64_t i = 0; i < leaf->axes; i++)
        if (a->shape[i] != leaf->shape[i])
            return false;
    Py_IncRef(o);
    t->held[t->at] = o;
    t->in[t->at++] = a->data;
    return true;
}

/* A number of numpy: it stands behind the head. */
static bool take_scalar(Taking *t, PyObject *o)
{
    if (type_of(o) != t->p->in[t->at].scalar)
        return false;
    Py_IncRef(o);
    t->held[t->at] = o;
    t->in[t->at++] = (char *)o + HEAD;
    return true;
}

static bool take_number(Taking *t, PyObject *o)
{
    const Program *p = t->p;
    PyObject *type = type_of(o);
    int64_t kind = p->in[t->at].numbers;
    Number *n = &t->numbers[t->at];
    bool whole = type == p->python_int;
    if (!kind || (type != p->python_float && !whole && type != p->python_bool))
        return false;
    if (kind == 'd' || kind == 'f') {
        double x = PyFloat_AsDouble(o);
        if (type == p->python_bool || (x == -1.0 && PyErr_Occurred()))
            return false;
        if (kind == 'd')
            n->d = x;
        else
            n->f = (float)x;
    } else {
        if (kind == '?' ? type != p->python_bool : !whole)
            return false;
        long long x = PyLong_AsLongLong(o);
        if ((x == -1 && PyErr_Occurred()) || (kind == 'i' && x != (int32_t)x))
            return false;
        if (kind == 'l')
            n->l = x;
        else if (kind == 'i')
            n->i = (int32_t)x;
        else
            n->b = x != 0;
    }
    t->in[t->at++] = n;
    return true;
}

/* The leaves of a tree into t; false where it is not just so, and then Python looks closer. */
static bool take(Taking *t, PyObject *o)
{
    const Node *node = t->node++;
    PyObject *child;
    if (node->kind == LEAF)
        return take_array(t, o) || take_number(t, o) || take_scalar(t, o);
    if (type_of(o) != node->type)
        return false;
    if (node->kind == DICT ? PyDict_Size(o) != node->count : node->kind == LIST && PyList_Size(o) != node->count)
        return false;
    if (node->kind == TUPLE && PyTuple_Size(o) != node->count)
        return false;
    for (int64_t i = 0; i < node->count; i++) {
        if (node->kind == RECORD) {
            child = PyObject_GetAttr(o, node->keys[i]);
        } else {
            child = node->kind == TUPLE ? PyTuple_GetItem(o, i)
                : node->kind == LIST    ? PyList_GetItem(o, i)
                                        : PyDict_GetItem(o, node->keys[i]);
            if (child)
                Py_IncRef(child);
        }
        bool good = child && take(t, child);
        if (child)
            Py_DecRef(child);
        if (!good)
            return false;
    }
    return true;
}

static void let_go(Taking *t)
{
    for (int64_t i = 0; i < t->p->n_in; i++)
        if (t->held[i]) {
            Py_DecRef(t->held[i]);
            t->held[i] = NULL;
        }
}

/* What Python makes of arguments that are not just so. */
static bool take_normalised(Taking *t, PyObject *const *arguments, Py_ssize_t count)
{
    PyErr_Clear();
    let_go(t);
    t->at = 0;
    PyObject *all = PyTuple_New(count);
    if (!all)
        return false;
    for (Py_ssize_t i = 0; i < count; i++) {
        Py_IncRef(arguments[i]);
        PyTuple_SetItem(all, i, arguments[i]);
    }
    PyObject *flat = PyObject_CallObject(t->p->normalise, all);
    Py_DecRef(all);
    bool good = flat != NULL;
    for (int64_t i = 0; good && i < t->p->n_in; i++)
        good = take_array(t, PyTuple_GetItem(flat, i));
    if (flat)
        Py_DecRef(flat);
    return good;
}

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
    PyObject *made = n->kind == TUPLE ? PyTuple_New(n->count) : n->kind == LIST ? PyList_New(n->count) : PyDict_New();
    for (int64_t i = 0; made && i < n->count; i++) {
        PyObject *child = give(p, node, results);
        if (!child) {
            Py_DecRef(made);
            return NULL;
        }
        if (n->kind == TUPLE)
            PyTuple_SetItem(made, i, child);
        else if (n->kind == LIST)
            PyList_SetItem(made, i, child);
        else {
            PyDict_SetItem(made, n->keys[i], child);
            Py_DecRef(child);
        }
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

static void *new_workspace(int64_t bytes)
{
    void *memory = NULL;
    return bytes && !posix_memalign(&memory, 64, (size_t)bytes) ? memory : NULL;
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

/* Arguments or results of which the pointers lie on the stack. */
enum { FEW = 32 };

/* What is given where `count` fits it, else new memory of these bytes for each; NULL, with an error set, where there is
 * none. */
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

static PyObject *run_into(Program *p, Taking *t, PyObject **results, void **out)
{
    PyObject *made = NULL;
    int64_t ready = 0;
    for (; ready < p->n_out; ready++) {
        results[ready] = PyObject_CallObject(p->empty, p->out[ready].empty);
        if (!results[ready])
            break;
        out[ready] = ((Array *)results[ready])->data;
    }
    void *memory = ready == p->n_out ? borrow_workspace(p) : NULL;
    if (ready == p->n_out && p->workspace && !memory) {
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
    } few;
    char *memory = room(p->n_in, sizeof(void *) + sizeof(PyObject *) + sizeof(Number), &few);
    if (!memory)
        return NULL;
    int64_t most = p->n_in > FEW ? p->n_in : FEW;
    const void **in = (const void **)memory;
    PyObject **held = (PyObject **)(in + most);
    memset(held, 0, (size_t)most * sizeof *held);
    Taking t = {p, p->takes + 1, 0, in, held, (Number *)(held + most)};
    bool good = count == p->takes[0].count;
    for (Py_ssize_t i = 0; good && i < count; i++)
        good = take(&t, arguments[i]);
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

/* A callable of this program; kept: what must live as long as it. */
PyObject *trimtab_callable(Program *p, PyObject *kept)
{
    PyObject *capsule = PyCapsule_New(p, NULL, end);
    PyObject *made = capsule ? PyCFunction_NewEx(&definition, capsule, kept) : NULL;
    if (capsule)
        Py_DecRef(capsule);
    return made;
}

/* Whether arrays, and numbers of numpy, lie in memory as is taken for granted here. */
int trimtab_knows_arrays(
    PyObject *array, PyObject *array_type, PyObject *type, void *data, int64_t rows, int64_t columns, PyObject *pi)
{
    const Array *a = (const Array *)array;
    double behind;
    memcpy(&behind, (char *)pi + HEAD, sizeof behind);
    return behind == 3.141592653589793 && type_of(array) == array_type && a->type == type && a->data == data && a->axes == 2 && a->shape[0] == rows
        && a->shape[1] == columns && (a->flags & NATIVE_AND_ALIGNED) == NATIVE_AND_ALIGNED;
}
