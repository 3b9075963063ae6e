/* Arguments of a compiled function: check them, and find the addresses of their numbers.
 *
 * The text uses Python's stable ABI, which is declared here, so that no headers are needed. It also uses the memory
 * layout of numpy's arrays, which numpy's ABI fixes. HEAD is the size of an object's head, defined before this text. */
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
PyObject *PyLong_FromLongLong(long long number);
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
int PyType_IsSubtype(PyObject *type, PyObject *of);
void Py_DecRef(PyObject *object);
void Py_IncRef(PyObject *object);

/* View of an object's memory (buffer protocol). */
typedef struct {
    void *data;
    PyObject *owner;
    Py_ssize_t bytes, each;
    int read_only, axes;
    char *format;
    Py_ssize_t *shape, *strides, *indirect;
    void *internal;
} View;

enum { FORMAT_AND_SHAPE = 0x0c }; /* without strides: only contiguous memory */
int PyObject_CheckBuffer(PyObject *object);
int PyObject_GetBuffer(PyObject *object, View *view, int flags);
void PyBuffer_Release(View *view);

/* Node of a tree; its parts follow it. NAMED: a named tuple. */
enum { LEAF, TUPLE, LIST, DICT, NOTHING, RECORD, NAMED };
typedef struct {
    int64_t kind, count;
    PyObject *type;  /* borrowed, as all objects here: `kept` keeps them alive */
    PyObject **keys; /* keys of a dict, or names of fields */
} Node;

/* Type of an array. For an array without axes, scalar is numpy's class of such a number, and numbers is the kind of
 * Python number that is accepted: 'd', 'f', 'l', 'i', '?'. For other arrays, they are NULL and 0. */
typedef struct {
    PyObject *type, *scalar;
    int64_t axes, numbers, format, width; /* format: as in a View; width: bytes of the array of one run */
    int64_t *shape;
    PyObject *empty; /* arguments of numpy.empty */
} Leaf;

typedef void (*Function)(const void *const *in, void *const *out, void *workspace, int32_t runs);

typedef struct {
    Function function;
    int64_t workspace, n_in, n_out, lanes, threads; /* lanes: runs side by side in many runs, or 0 for one run */
    Leaf *in, *out;
    Node *takes, *gives;
    PyObject *array, *python_float, *python_int, *python_bool, *empty, *none;
    PyObject *normalise; /* (all arguments) -> flat tuple of arrays of the right types; raises */
    PyObject *assemble;  /* (flat results) -> tree, or NULL if `gives` describes the tree */
    void *spare;         /* a workspace that no call uses at present */
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

/* Arguments of a call. runs: number of runs; -1 if no array has an axis of runs. shared: number of arrays without. */
typedef struct {
    const Program *p;
    const Node *node;
    int64_t at, runs, shared, viewed;
    const void **in;
    PyObject **held;
    Number *numbers;
    char *once; /* for each array: 1 if all runs share it */
    View *views;
} Taking;

static PyObject *type_of(PyObject *o)
{
    return *(PyObject **)((char *)o + HEAD - sizeof(PyObject *));
}

/* True if a shape is that of a leaf, or of many runs of it. The number of runs is stored. */
static bool fits(Taking *t, const Leaf *leaf, int64_t axes, const Py_ssize_t *shape)
{
    bool many = t->p->lanes && axes == leaf->axes + 1;
    if (!many && axes != leaf->axes)
        return false;
    for (int64_t i = 0; i < leaf->axes; i++)
        if (shape[i + many] != leaf->shape[i])
            return false;
    if (many && t->runs >= 0 && shape[0] != t->runs)
        return false;
    if (many)
        t->runs = shape[0];
    t->once[t->at] = !many;
    t->shared += !many;
    return true;
}

static bool take_array(Taking *t, PyObject *o)
{
    const Leaf *leaf = &t->p->in[t->at];
    const Array *a = (const Array *)o;
    if (type_of(o) != t->p->array || a->type != leaf->type)
        return false;
    if ((a->flags & NATIVE_AND_ALIGNED) != NATIVE_AND_ALIGNED || !fits(t, leaf, a->axes, a->shape))
        return false;
    Py_IncRef(o);
    t->held[t->at] = o;
    t->in[t->at++] = a->data;
    return true;
}

/* Take an object with the buffer protocol, such as a jax.Array. Subclasses of numpy's array are left to Python code. */
static bool take_view(Taking *t, PyObject *o)
{
    const Leaf *leaf = &t->p->in[t->at];
    View *view = &t->views[t->viewed];
    if (!leaf->format || !PyObject_CheckBuffer(o) || PyType_IsSubtype(type_of(o), t->p->array))
        return false;
    if (PyObject_GetBuffer(o, view, FORMAT_AND_SHAPE)) {
        PyErr_Clear();
        return false;
    }
    t->viewed++;
    const char *format = view->format ? view->format : "";
    format += *format == '='; /* '=': standard size, which these types have */
    bool same = format[0] == leaf->format && !format[1] && view->data;
    if (!same || (uintptr_t)view->data % (uintptr_t)view->each || !fits(t, leaf, view->axes, view->shape))
        return false;
    t->in[t->at++] = view->data;
    return true;
}

/* Take a numpy scalar. Its number is in memory after the object's head. */
static bool take_scalar(Taking *t, PyObject *o)
{
    if (type_of(o) != t->p->in[t->at].scalar)
        return false;
    Py_IncRef(o);
    fits(t, &t->p->in[t->at], 0, NULL);
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
    fits(t, &p->in[t->at], 0, NULL);
    t->in[t->at++] = n;
    return true;
}

/* Take the leaves of a tree into t. Return false if it is not exactly as described; Python code then checks it. */
static bool take(Taking *t, PyObject *o)
{
    const Node *node = t->node++;
    PyObject *child;
    if (node->kind == LEAF)
        return take_array(t, o) || take_number(t, o) || take_scalar(t, o) || take_view(t, o);
    if (type_of(o) != node->type)
        return false;
    if (node->kind == DICT ? PyDict_Size(o) != node->count : node->kind == LIST && PyList_Size(o) != node->count)
        return false;
    bool tuple = node->kind == TUPLE || node->kind == NAMED;
    if (tuple && PyTuple_Size(o) != node->count)
        return false;
    for (int64_t i = 0; i < node->count; i++) {
        if (node->kind == RECORD) {
            child = PyObject_GetAttr(o, node->keys[i]);
        } else {
            child = tuple ? PyTuple_GetItem(o, i)
                : node->kind == LIST ? PyList_GetItem(o, i)
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
    while (t->viewed)
        PyBuffer_Release(&t->views[--t->viewed]);
    for (int64_t i = 0; i < t->p->n_in; i++)
        if (t->held[i]) {
            Py_DecRef(t->held[i]);
            t->held[i] = NULL;
        }
    t->at = t->shared = 0;
    t->runs = -1;
}

/* Take arguments that are not exactly as described, after Python code has converted them. */
static bool take_normalised(Taking *t, PyObject *const *arguments, Py_ssize_t count)
{
    PyErr_Clear();
    let_go(t);
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
