// Client of Adverb in one file, for Unity and other .NET: netstandard2.0, C# 6, nothing beyond the base class library.
//
// REST (AdverbClient), streams with a jitter buffer (AdverbStream), verbs evaluated in the client (VerbEvaluator).
// Coordinates are right-handed, +Y up, +Z forward, +X left; metres, seconds, radians; quaternions x, y, z, w.
// Poses are float arrays: root x, y, z in metres, then x, y, z, w for each joint. `Frames` converts them to Unity.
//
// Binary formats: docs/wire.md and docs/artifact.md of the project.

using System;
using System.Collections.Generic;
using System.Diagnostics;
using System.Globalization;
using System.IO;
using System.Net.Http;
using System.Net.Http.Headers;
using System.Net.WebSockets;
using System.Security.Cryptography;
using System.Text;
using System.Threading;
using System.Threading.Tasks;

namespace Adverb
{
    /// <summary>An error of a server, of the network or of a message, with a stable code.</summary>
    public sealed class AdverbException : Exception
    {
        /// <summary>Stable code, as in the server's documentation; in addition <c>offline</c>, <c>timed_out</c>,
        /// <c>closed</c>, <c>malformed</c> and <c>artifact_invalid</c>.</summary>
        public string Code { get; private set; }

        /// <summary>What was wrong and what is allowed.</summary>
        public string Detail { get; private set; }

        /// <summary>HTTP status; 0 where there is none.</summary>
        public int Status { get; private set; }

        /// <summary>Id of the request in the server's log; null where there is none.</summary>
        public string RequestId { get; private set; }

        /// <summary>Makes an error.</summary>
        public AdverbException(string code, string detail, int status = 0, string requestId = null,
            Exception inner = null)
            : base(code + ": " + detail, inner)
        {
            Code = code;
            Detail = detail;
            Status = status;
            RequestId = requestId;
        }
    }

    /// <summary>
    /// Reads and writes JSON. Objects are <c>Dictionary&lt;string, object&gt;</c>, arrays <c>List&lt;object&gt;</c>,
    /// numbers <c>long</c> (integers) or <c>double</c>, otherwise <c>string</c>, <c>bool</c> and null.
    /// </summary>
    public static class Json
    {
        const int MaxDepth = 64;

        /// <summary>Reads a text.</summary>
        /// <exception cref="AdverbException">It is not JSON, or nested more than 64 levels deep:
        /// <c>malformed</c>.</exception>
        public static object Parse(string text)
        {
            int at = 0;
            object value = Value(text, ref at, 0);
            Blank(text, ref at);
            if (at != text.Length) throw Bad(at);
            return value;
        }

        /// <summary>Reads a text that is an object.</summary>
        public static Dictionary<string, object> ParseObject(string text)
        {
            return AsObject(Parse(text), "the message");
        }

        /// <summary>Writes a value; dictionaries with text keys, lists, numbers, texts, bool and null.</summary>
        public static string Write(object value)
        {
            var text = new StringBuilder();
            Append(text, value);
            return text.ToString();
        }

        internal static Dictionary<string, object> AsObject(object value, string name)
        {
            var found = value as Dictionary<string, object>;
            if (found == null) throw new AdverbException("malformed", name + " is not an object");
            return found;
        }

        internal static object Get(Dictionary<string, object> fields, string name)
        {
            object value;
            if (!fields.TryGetValue(name, out value)) throw new AdverbException("malformed", name + " is missing");
            return value;
        }

        internal static string Text(Dictionary<string, object> fields, string name)
        {
            var found = Get(fields, name) as string;
            if (found == null) throw new AdverbException("malformed", name + " is not a text");
            return found;
        }

        internal static double Number(object value, string name)
        {
            if (value is long) return (long)value;
            if (value is double) return (double)value;
            throw new AdverbException("malformed", name + " is not a number");
        }

        internal static double Number(Dictionary<string, object> fields, string name)
        {
            return Number(Get(fields, name), name);
        }

        internal static long Integer(Dictionary<string, object> fields, string name)
        {
            object value = Get(fields, name);
            if (!(value is long)) throw new AdverbException("malformed", name + " is not an integer");
            return (long)value;
        }

        internal static bool Flag(Dictionary<string, object> fields, string name)
        {
            object value = Get(fields, name);
            if (!(value is bool)) throw new AdverbException("malformed", name + " is not true or false");
            return (bool)value;
        }

        internal static List<object> Items(Dictionary<string, object> fields, string name)
        {
            var found = Get(fields, name) as List<object>;
            if (found == null) throw new AdverbException("malformed", name + " is not an array");
            return found;
        }

        internal static string[] Texts(Dictionary<string, object> fields, string name)
        {
            List<object> items = Items(fields, name);
            var found = new string[items.Count];
            for (int k = 0; k < found.Length; k++)
            {
                found[k] = items[k] as string;
                if (found[k] == null) throw new AdverbException("malformed", name + " has an item that is not a text");
            }
            return found;
        }

        static AdverbException Bad(int at)
        {
            return new AdverbException("malformed", "not JSON at character " + at);
        }

        static void Blank(string text, ref int at)
        {
            while (at < text.Length && (text[at] == ' ' || text[at] == '\n' || text[at] == '\r'
                || text[at] == '\t')) at++;
        }

        static object Value(string text, ref int at, int depth)
        {
            Blank(text, ref at);
            if (at >= text.Length || depth > MaxDepth) throw Bad(at);
            switch (text[at])
            {
                case '{': return Object(text, ref at, depth);
                case '[': return Array(text, ref at, depth);
                case '"': return String(text, ref at);
                case 't': Word(text, ref at, "true"); return true;
                case 'f': Word(text, ref at, "false"); return false;
                case 'n': Word(text, ref at, "null"); return null;
                default: return NumberAt(text, ref at);
            }
        }

        static void Word(string text, ref int at, string word)
        {
            if (string.CompareOrdinal(text, at, word, 0, word.Length) != 0) throw Bad(at);
            at += word.Length;
        }

        static object Object(string text, ref int at, int depth)
        {
            var found = new Dictionary<string, object>(StringComparer.Ordinal);
            at++;
            Blank(text, ref at);
            if (at < text.Length && text[at] == '}') { at++; return found; }
            while (true)
            {
                Blank(text, ref at);
                if (at >= text.Length || text[at] != '"') throw Bad(at);
                string name = String(text, ref at);
                Blank(text, ref at);
                if (at >= text.Length || text[at++] != ':') throw Bad(at);
                found[name] = Value(text, ref at, depth + 1);
                if (End(text, ref at, '}')) return found;
            }
        }

        static object Array(string text, ref int at, int depth)
        {
            var found = new List<object>();
            at++;
            Blank(text, ref at);
            if (at < text.Length && text[at] == ']') { at++; return found; }
            while (true)
            {
                found.Add(Value(text, ref at, depth + 1));
                if (End(text, ref at, ']')) return found;
            }
        }

        static bool End(string text, ref int at, char end)
        {
            Blank(text, ref at);
            if (at >= text.Length) throw Bad(at);
            char found = text[at++];
            if (found == end) return true;
            if (found != ',') throw Bad(at - 1);
            return false;
        }

        static string String(string text, ref int at)
        {
            int start = ++at;
            while (at < text.Length && text[at] != '"' && text[at] != '\\') at++;
            if (at < text.Length && text[at] == '"') return text.Substring(start, at++ - start);
            var found = new StringBuilder(text, start, at - start, Math.Max(16, at - start + 16));
            while (true)
            {
                if (at >= text.Length) throw Bad(at);
                char next = text[at++];
                if (next == '"') return found.ToString();
                found.Append(next == '\\' ? Escaped(text, ref at) : next);
            }
        }

        static char Escaped(string text, ref int at)
        {
            if (at >= text.Length) throw Bad(at);
            char kind = text[at++];
            switch (kind)
            {
                case '"': case '\\': case '/': return kind;
                case 'b': return '\b';
                case 'f': return '\f';
                case 'n': return '\n';
                case 'r': return '\r';
                case 't': return '\t';
            }
            int code;
            if (kind != 'u' || at + 4 > text.Length
                || !int.TryParse(text.Substring(at, 4), NumberStyles.AllowHexSpecifier,
                CultureInfo.InvariantCulture, out code)) throw Bad(at);
            at += 4;
            return (char)code;
        }

        static object NumberAt(string text, ref int at)
        {
            int start = at;
            bool whole = true;
            while (at < text.Length && "+-.eE0123456789".IndexOf(text[at]) >= 0)
            {
                if (".eE".IndexOf(text[at]) >= 0) whole = false;
                at++;
            }
            string part = text.Substring(start, at - start);
            long integer;
            if (whole && long.TryParse(part, NumberStyles.AllowLeadingSign, CultureInfo.InvariantCulture, out integer))
                return integer;
            double number;
            if (part.Length == 0 || part[0] == '+'
                || !double.TryParse(part, NumberStyles.Float, CultureInfo.InvariantCulture,
                out number) || double.IsInfinity(number)) throw Bad(start);
            return number == 0.0 && part[0] == '-' ? -0.0 : number; // some runtimes drop the sign
        }

        static void Append(StringBuilder text, object value)
        {
            if (value == null) text.Append("null");
            else if (value is string) AppendText(text, (string)value);
            else if (value is bool) text.Append((bool)value ? "true" : "false");
            else if (value is int || value is long || value is uint)
                text.Append(Convert.ToString(value, CultureInfo.InvariantCulture));
            else if (value is double || value is float) AppendNumber(text, Convert.ToDouble(value), value is float);
            else if (value is System.Collections.IDictionary) AppendObject(text, (System.Collections.IDictionary)value);
            else AppendItems(text, (System.Collections.IEnumerable)value);
        }

        static void AppendNumber(StringBuilder text, double value, bool single)
        {
            if (double.IsNaN(value) || double.IsInfinity(value))
                throw new ArgumentException("a number is not finite");
            text.Append(single ? ((float)value).ToString("R", CultureInfo.InvariantCulture)
                : value.ToString("R", CultureInfo.InvariantCulture));
        }

        static void AppendObject(StringBuilder text, System.Collections.IDictionary fields)
        {
            text.Append('{');
            int start = text.Length;
            foreach (System.Collections.DictionaryEntry field in fields)
            {
                if (text.Length > start) text.Append(',');
                AppendText(text, (string)field.Key);
                text.Append(':');
                Append(text, field.Value);
            }
            text.Append('}');
        }

        static void AppendItems(StringBuilder text, System.Collections.IEnumerable items)
        {
            text.Append('[');
            int start = text.Length;
            foreach (object item in items)
            {
                if (text.Length > start) text.Append(',');
                Append(text, item);
            }
            text.Append(']');
        }

        static void AppendText(StringBuilder text, string value)
        {
            text.Append('"');
            foreach (char each in value)
            {
                if (each == '"' || each == '\\') text.Append('\\').Append(each);
                else if (each < ' ')
                    text.Append("\\u").Append(((int)each).ToString("x4", CultureInfo.InvariantCulture));
                else text.Append(each);
            }
            text.Append('"');
        }
    }

    /// <summary>Quaternions x, y, z, w inside flat arrays.</summary>
    static class Quat
    {
        const double SmallAngle = 1e-4;

        /// <summary>out = a ∘ b: first b, then a. The arrays may be the same.</summary>
        internal static void Multiply(double[] a, int i, double[] b, int j, double[] result, int o)
        {
            double ax = a[i], ay = a[i + 1], az = a[i + 2], aw = a[i + 3];
            double bx = b[j], by = b[j + 1], bz = b[j + 2], bw = b[j + 3];
            result[o] = aw * bx + ax * bw + ay * bz - az * by;
            result[o + 1] = aw * by + ay * bw + az * bx - ax * bz;
            result[o + 2] = aw * bz + az * bw + ax * by - ay * bx;
            result[o + 3] = aw * bw - ax * bx - ay * by - az * bz;
        }

        /// <summary>Interpolates on the shorter arc; a share above 1 extrapolates.</summary>
        internal static void Slerp(float[] a, float[] b, int at, double share, float[] result)
        {
            double dot = 0.0;
            for (int k = 0; k < 4; k++) dot += (double)a[at + k] * b[at + k];
            double angle = Math.Acos(Math.Min(Math.Abs(dot), 1.0));
            double from = 1.0 - share, to = share;
            if (angle >= SmallAngle)
            {
                double sine = Math.Sin(angle);
                from = Math.Sin(from * angle) / sine;
                to = Math.Sin(to * angle) / sine;
            }
            if (dot < 0.0) to = -to;
            double x = from * a[at] + to * b[at], y = from * a[at + 1] + to * b[at + 1];
            double z = from * a[at + 2] + to * b[at + 2], w = from * a[at + 3] + to * b[at + 3];
            double length = Math.Sqrt(x * x + y * y + z * z + w * w);
            result[at] = (float)(x / length);
            result[at + 1] = (float)(y / length);
            result[at + 2] = (float)(z / length);
            result[at + 3] = (float)(w / length);
        }
    }

    /// <summary>
    /// Conversions between the frame of a server (glTF: right-handed, +X left) and Unity (left-handed, +X right); both
    /// have +Y up and +Z forward. They are their own inverses. A server converts for channels opened with
    /// <c>Frame = "unity"</c>; REST and the evaluator have glTF poses.
    /// </summary>
    public static class Frames
    {
        /// <summary>Mirrors positions x, y, z in place.</summary>
        public static void FlipPositions(float[] positions, int start, int count)
        {
            for (int k = start; k < start + 3 * count; k += 3) positions[k] = -positions[k];
        }

        /// <summary>Mirrors rotations x, y, z, w in place.</summary>
        public static void FlipRotations(float[] rotations, int start, int count)
        {
            for (int k = start; k < start + 4 * count; k += 4)
            {
                rotations[k + 1] = -rotations[k + 1];
                rotations[k + 2] = -rotations[k + 2];
            }
        }

        /// <summary>Converts a pose in place: root x, y, z, then x, y, z, w per joint.</summary>
        public static void FlipPose(float[] values)
        {
            FlipPositions(values, 0, 1);
            FlipRotations(values, 3, (values.Length - 3) / 4);
        }

        /// <summary>The skeleton with its offsets converted.</summary>
        public static Skeleton Flip(Skeleton skeleton)
        {
            var offsets = (double[])skeleton.Offsets.Clone();
            for (int k = 0; k < offsets.Length; k += 3) offsets[k] = -offsets[k];
            return new Skeleton(skeleton.Names, skeleton.Parents, offsets);
        }
    }

    /// <summary>Joints of a figure: parents before children.</summary>
    public sealed class Skeleton
    {
        /// <summary>Names, the root first.</summary>
        public readonly string[] Names;

        /// <summary>Index of each joint's parent; −1 for the root.</summary>
        public readonly int[] Parents;

        /// <summary>Positions in the parents' frames: 3 numbers per joint, metres.</summary>
        public readonly double[] Offsets;

        double[] _rotations = new double[0], _positions = new double[0];

        /// <summary>Makes a skeleton.</summary>
        public Skeleton(string[] names, int[] parents, double[] offsets)
        {
            bool valid = names.Length > 0 && parents.Length == names.Length && offsets.Length == 3 * names.Length;
            for (int j = 0; valid && j < parents.Length; j++) valid = parents[j] < j && parents[j] >= (j > 0 ? 0 : -1);
            if (!valid)
                throw new AdverbException("malformed", "the skeleton's parents do not come before their children");
            Names = names;
            Parents = parents;
            Offsets = offsets;
        }

        /// <summary>Index of a joint; −1 where there is none of the name.</summary>
        public int IndexOf(string name)
        {
            return Array.IndexOf(Names, name);
        }

        /// <summary>
        /// Global positions of all joints, 3 numbers each in metres, and where given global rotations, 4 numbers each.
        /// Not for several threads at once.
        /// </summary>
        /// <param name="values">Root x, y, z, then local rotations x, y, z, w per joint.</param>
        /// <param name="positions">Written.</param>
        /// <param name="rotations">Written; may be null.</param>
        public void Solve(float[] values, float[] positions, float[] rotations = null)
        {
            if (values.Length != 3 + 4 * Names.Length || positions.Length != 3 * Names.Length)
                throw new ArgumentException("the arrays do not fit the skeleton's " + Names.Length + " joints");
            if (_rotations.Length == 0)
            {
                _rotations = new double[4 * Names.Length + 4];
                _positions = new double[3 * Names.Length];
            }
            int local = 4 * Names.Length;
            for (int j = 0; j < Names.Length; j++)
            {
                for (int k = 0; k < 4; k++) _rotations[local + k] = values[3 + 4 * j + k];
                int parent = Parents[j];
                if (parent < 0)
                {
                    for (int k = 0; k < 4; k++) _rotations[4 * j + k] = _rotations[local + k];
                    for (int k = 0; k < 3; k++) _positions[3 * j + k] = values[k];
                    continue;
                }
                Quat.Multiply(_rotations, 4 * parent, _rotations, local, _rotations, 4 * j);
                Locate(j, parent);
            }
            for (int k = 0; k < positions.Length; k++) positions[k] = (float)_positions[k];
            if (rotations != null) for (int k = 0; k < rotations.Length; k++) rotations[k] = (float)_rotations[k];
        }

        void Locate(int j, int parent)
        {
            double x = _rotations[4 * parent], y = _rotations[4 * parent + 1];
            double z = _rotations[4 * parent + 2], w = _rotations[4 * parent + 3];
            double vx = Offsets[3 * j], vy = Offsets[3 * j + 1], vz = Offsets[3 * j + 2];
            double tx = 2.0 * (y * vz - z * vy), ty = 2.0 * (z * vx - x * vz), tz = 2.0 * (x * vy - y * vx);
            _positions[3 * j] = _positions[3 * parent] + vx + w * tx + y * tz - z * ty;
            _positions[3 * j + 1] = _positions[3 * parent + 1] + vy + w * ty + z * tx - x * tz;
            _positions[3 * j + 2] = _positions[3 * parent + 2] + vz + w * tz + x * ty - y * tx;
        }

        internal static Skeleton Of(Dictionary<string, object> fields)
        {
            List<object> parents = Json.Items(fields, "parents"), rows = Json.Items(fields, "offsets");
            var indices = new int[parents.Count];
            var offsets = new double[3 * rows.Count];
            for (int j = 0; j < indices.Length; j++) indices[j] = (int)Json.Number(parents[j], "parents");
            for (int j = 0; j < rows.Count; j++)
            {
                var row = rows[j] as List<object>;
                if (row == null || row.Count != 3)
                    throw new AdverbException("malformed", "offsets are not rows of three");
                for (int k = 0; k < 3; k++) offsets[3 * j + k] = Json.Number(row[k], "offsets");
            }
            return new Skeleton(Json.Texts(fields, "names"), indices, offsets);
        }
    }

    /// <summary>One adverb of a verb.</summary>
    public sealed class AdverbInfo
    {
        /// <summary>Name.</summary>
        public readonly string Name;

        /// <summary>Unit of its values.</summary>
        public readonly string Unit;

        /// <summary>Least value over the examples.</summary>
        public readonly double Min;

        /// <summary>Largest value over the examples.</summary>
        public readonly double Max;

        /// <summary>Whether it cannot be measured from the motion.</summary>
        public readonly bool Style;

        internal AdverbInfo(string name, string unit, double min, double max, bool style)
        {
            Name = name;
            Unit = unit;
            Min = min;
            Max = max;
            Style = style;
        }

        internal static AdverbInfo[] Of(List<object> rows)
        {
            var found = new AdverbInfo[rows.Count];
            for (int k = 0; k < found.Length; k++)
            {
                Dictionary<string, object> row = Json.AsObject(rows[k], "an adverb");
                found[k] = new AdverbInfo(Json.Text(row, "name"), Json.Text(row, "unit"), Json.Number(row, "min"),
                    Json.Number(row, "max"), Json.Flag(row, "style"));
            }
            return found;
        }
    }

    /// <summary>A verb in the server's list.</summary>
    public sealed class VerbSummary
    {
        /// <summary>Name of the verb.</summary>
        public string Name;

        /// <summary>What it is.</summary>
        public string Description;

        /// <summary>Version that is served.</summary>
        public int Version;

        /// <summary>Whether the end of a cycle is the start of the next.</summary>
        public bool Looping;

        /// <summary>Names of the adverbs.</summary>
        public string[] Adverbs;

        internal static VerbSummary Of(Dictionary<string, object> fields)
        {
            return new VerbSummary
            {
                Name = Json.Text(fields, "name"),
                Description = Json.Text(fields, "description"),
                Version = (int)Json.Integer(fields, "version"),
                Looping = Json.Flag(fields, "looping"),
                Adverbs = Json.Texts(fields, "adverbs"),
            };
        }
    }

    /// <summary>A verb as the server describes it.</summary>
    public sealed class VerbInfo
    {
        /// <summary>Name of the verb.</summary>
        public string Name;

        /// <summary>What it is.</summary>
        public string Description;

        /// <summary>Version that is served.</summary>
        public int Version;

        /// <summary>Whether the end of a cycle is the start of the next.</summary>
        public bool Looping;

        /// <summary>Adverbs in the order of binary messages.</summary>
        public AdverbInfo[] Adverbs;

        /// <summary>Joints.</summary>
        public Skeleton Skeleton;

        /// <summary>All fields of the server's answer.</summary>
        public Dictionary<string, object> Fields;

        internal static VerbInfo Of(Dictionary<string, object> fields)
        {
            return new VerbInfo
            {
                Name = Json.Text(fields, "name"),
                Description = Json.Text(fields, "description"),
                Version = (int)Json.Integer(fields, "version"),
                Looping = Json.Flag(fields, "looping"),
                Adverbs = AdverbInfo.Of(Json.Items(fields, "adverbs")),
                Skeleton = Skeleton.Of(Json.AsObject(Json.Get(fields, "skeleton"), "skeleton")),
                Fields = fields,
            };
        }
    }

    /// <summary>Options of a pose; null is the server's default.</summary>
    public class PoseOptions
    {
        /// <summary>Canonical time 0–1, more in a loop; not together with <see cref="Time"/>.</summary>
        public double? Phase;

        /// <summary>Seconds from the start.</summary>
        public double? Time;

        /// <summary>Method of the verb.</summary>
        public string Method;

        /// <summary><c>local</c> or <c>global</c> rotations.</summary>
        public string Space;

        /// <summary>Joints to return.</summary>
        public string[] Joints;

        /// <summary>Version to evaluate.</summary>
        public int? Version;

        /// <summary>Whether standing feet are held.</summary>
        public bool? Plant;

        /// <summary>Whether records have the support.</summary>
        public bool? Support;

        internal Dictionary<string, object> Fields(IDictionary<string, double> adverbs)
        {
            var fields = new Dictionary<string, object> { { "adverbs", new Dictionary<string, double>(adverbs) } };
            Options.Add(fields, "phase", Phase);
            Options.Add(fields, "time", Time);
            Options.Add(fields, "method", Method);
            Options.Add(fields, "space", Space);
            Options.Add(fields, "joints", Joints);
            Options.Add(fields, "version", Version);
            Options.Add(fields, "plant", Plant);
            Options.Add(fields, "support", Support);
            return fields;
        }
    }

    static class Options
    {
        internal static void Add(Dictionary<string, object> fields, string name, object value)
        {
            if (value != null) fields[name] = value;
        }
    }

    /// <summary>REST calls to a server. Methods may run at the same time.</summary>
    public sealed class AdverbClient : IDisposable
    {
        readonly HttpClient _http;
        readonly string _root;

        /// <summary>Makes a client.</summary>
        /// <param name="baseUrl">Address of the server, such as <c>http://127.0.0.1:8000</c>.</param>
        /// <param name="key">Key; null where the server requires none.</param>
        /// <param name="timeoutS">Longest time of a request, seconds.</param>
        public AdverbClient(string baseUrl, string key = null, double timeoutS = 30.0)
        {
            var uri = new Uri(baseUrl);
            if (uri.Scheme != "http" && uri.Scheme != "https")
                throw new ArgumentException("expected http://… or https://…, got " + baseUrl);
            _root = baseUrl.TrimEnd('/');
            _http = new HttpClient { Timeout = TimeSpan.FromSeconds(timeoutS) };
            if (key != null) _http.DefaultRequestHeaders.Authorization = new AuthenticationHeaderValue("Bearer", key);
        }

        /// <summary>The verbs that are served.</summary>
        public async Task<VerbSummary[]> VerbsAsync()
        {
            List<object> rows = Json.Items(await ObjectAsync("/v1/verbs").ConfigureAwait(false), "verbs");
            var found = new VerbSummary[rows.Count];
            for (int k = 0; k < found.Length; k++) found[k] = VerbSummary.Of(Json.AsObject(rows[k], "a verb"));
            return found;
        }

        /// <summary>One verb, with its skeleton.</summary>
        public async Task<VerbInfo> DescribeAsync(string verb)
        {
            return VerbInfo.Of(await ObjectAsync(PathOf(verb, "")).ConfigureAwait(false));
        }

        /// <summary>One pose.</summary>
        public async Task<WireRecord> PoseAsync(string verb, IDictionary<string, double> adverbs,
            PoseOptions options = null)
        {
            Dictionary<string, object> fields = (options ?? new PoseOptions()).Fields(adverbs);
            byte[] content = await PostAsync(PathOf(verb, "/pose"), fields).ConfigureAwait(false);
            int joints = (content.Length - 36) / 16;
            return RecordsOf(content, joints)[0];
        }

        /// <summary>A whole motion: one record for each frame.</summary>
        /// <param name="verb">Name of the verb.</param>
        /// <param name="adverbs">All adverbs by name.</param>
        /// <param name="fps">Frames per second.</param>
        /// <param name="cycles">Cycles of a loop; null: one.</param>
        /// <param name="options">Without <c>Phase</c> and <c>Time</c>.</param>
        public async Task<WireRecord[]> SequenceAsync(string verb, IDictionary<string, double> adverbs,
            double fps = 60.0, int? cycles = null, PoseOptions options = null)
        {
            string[] joints = options == null ? null : options.Joints;
            int count = joints != null ? joints.Length
                : (await DescribeAsync(verb).ConfigureAwait(false)).Skeleton.Names.Length;
            Dictionary<string, object> fields = (options ?? new PoseOptions()).Fields(adverbs);
            fields["fps"] = fps;
            Options.Add(fields, "cycles", cycles);
            WireRecord[] found = RecordsOf(await PostAsync(PathOf(verb, "/sequence"), fields).ConfigureAwait(false),
                count);
            if (!found[found.Length - 1].Last) throw new AdverbException("malformed", "the sequence is cut off");
            return found;
        }

        /// <summary>The verb file of the served version, or of another one, for <see cref="VerbEvaluator"/>.</summary>
        public Task<byte[]> DownloadArtifactAsync(string verb, int? version = null)
        {
            string path = version == null ? "/artifact" : "/versions/"
                + version.Value.ToString(CultureInfo.InvariantCulture);
            return SendAsync(HttpMethod.Get, PathOf(verb, path), null, "application/octet-stream");
        }

        /// <summary>The key of the client: its scopes.</summary>
        internal Task<Dictionary<string, object>> AccessAsync()
        {
            return ObjectAsync("/v1/access");
        }

        /// <summary>Closes connections.</summary>
        public void Dispose()
        {
            _http.Dispose();
        }

        static string PathOf(string verb, string rest)
        {
            return "/v1/verbs/" + Uri.EscapeDataString(verb) + rest;
        }

        static WireRecord[] RecordsOf(byte[] content, int joints)
        {
            var layout = new WireLayout(Encodings.F32, joints);
            if (joints < 1 || content.Length == 0 || content.Length % layout.RecordBytes != 0)
                throw new AdverbException("malformed", content.Length + " bytes are not whole records");
            var found = new WireRecord[content.Length / layout.RecordBytes];
            for (int k = 0, at = 0; k < found.Length; k++)
                at = Wire.ReadRecord(content, content.Length, at, layout, found[k] = new WireRecord());
            return found;
        }

        async Task<Dictionary<string, object>> ObjectAsync(string path)
        {
            byte[] content = await SendAsync(HttpMethod.Get, path, null, "application/json").ConfigureAwait(false);
            return Json.ParseObject(Encoding.UTF8.GetString(content));
        }

        Task<byte[]> PostAsync(string path, Dictionary<string, object> fields)
        {
            return SendAsync(HttpMethod.Post, path, Json.Write(fields), "application/octet-stream");
        }

        async Task<byte[]> SendAsync(HttpMethod method, string path, string body, string accept)
        {
            using (var request = new HttpRequestMessage(method, _root + path))
            {
                request.Headers.Accept.ParseAdd(accept);
                if (body != null) request.Content = new StringContent(body, Encoding.UTF8, "application/json");
                try
                {
                    using (HttpResponseMessage response = await _http.SendAsync(request).ConfigureAwait(false))
                    {
                        byte[] content = await response.Content.ReadAsByteArrayAsync().ConfigureAwait(false);
                        if (!response.IsSuccessStatusCode) throw ErrorOf(response, content);
                        return content;
                    }
                }
                catch (OperationCanceledException error)
                {
                    throw new AdverbException("timed_out", _root + path + ": no answer in time", 0, null, error);
                }
                catch (HttpRequestException error)
                {
                    string reason = (error.InnerException ?? error).Message;
                    throw new AdverbException("offline", _root + " cannot be reached: " + reason, 0, null, error);
                }
                catch (IOException error)
                {
                    throw new AdverbException("offline", _root + ": " + error.Message, 0, null, error);
                }
            }
        }

        static AdverbException ErrorOf(HttpResponseMessage response, byte[] content)
        {
            int status = (int)response.StatusCode;
            IEnumerable<string> ids;
            string id = null;
            if (response.Headers.TryGetValues("X-Request-Id", out ids)) foreach (string each in ids) id = each;
            try
            {
                Dictionary<string, object> fields = Json.ParseObject(Encoding.UTF8.GetString(content));
                return new AdverbException(Json.Text(fields, "code"), Json.Text(fields, "detail"), status, id);
            }
            catch (AdverbException)
            {
                return new AdverbException("http_" + status, "the server answered with status " + status, status, id);
            }
        }
    }

    /// <summary>Layouts of records: numbers of the wire and their names.</summary>
    public static class Encodings
    {
        /// <summary>Root and rotations as float32.</summary>
        public const int F32 = 0;

        /// <summary>Rotations in 48 bits.</summary>
        public const int Q48 = 1;

        /// <summary>Weights of the examples.</summary>
        public const int Weights = 2;

        /// <summary>Rotations in 32 bits.</summary>
        public const int Q32 = 3;

        internal static readonly string[] Names = { "f32", "q48", "weights", "q32" };
    }

    /// <summary>Layout of a channel's records.</summary>
    public sealed class WireLayout
    {
        /// <summary>Number of the encoding.</summary>
        public readonly int Encoding;

        /// <summary>Number of joints; for weights the number of examples.</summary>
        public readonly int Count;

        /// <summary>Makes a layout.</summary>
        public WireLayout(int encoding, int count)
        {
            Encoding = encoding;
            Count = count;
        }

        /// <summary>Length of a record, with padding.</summary>
        public int RecordBytes
        {
            get { return BytesOf(Encoding, Count); }
        }

        internal static int BytesOf(int encoding, int count)
        {
            switch (encoding)
            {
                case Encodings.F32: return 36 + 16 * count;
                case Encodings.Q48: return 36 + (6 * count + 3) / 4 * 4;
                case Encodings.Weights: return 28 + 4 * count;
                default: return 36 + 4 * count;
            }
        }

        /// <summary>The layout that a message <c>opened</c> states.</summary>
        /// <exception cref="AdverbException">The encoding is unknown, or the length does not fit.</exception>
        public static WireLayout Of(string encoding, int joints, int recordBytes)
        {
            int number = Array.IndexOf(Encodings.Names, encoding);
            if (number < 0) throw new AdverbException("malformed", "unknown encoding " + encoding);
            if (number == Encodings.Weights) joints = (recordBytes - 28) / 4;
            var found = new WireLayout(number, joints);
            if (joints < 0 || found.RecordBytes != recordBytes)
                throw new AdverbException("malformed", "records of " + recordBytes + " bytes do not fit as "
                    + encoding);
            return found;
        }
    }

    /// <summary>One pose, as records have it. The arrays are reused where a record is read again.</summary>
    public sealed class WireRecord
    {
        /// <summary>Number of the channel.</summary>
        public int Channel;

        /// <summary>Number of the encoding.</summary>
        public int Encoding;

        /// <summary>Flags, as in docs/wire.md.</summary>
        public int Flags;

        /// <summary>Version of the verb.</summary>
        public uint Version;

        /// <summary>Canonical time.</summary>
        public float Phase;

        /// <summary>Seconds from the start.</summary>
        public float Time;

        /// <summary>Distance from the goal, m; NaN where nothing is measured.</summary>
        public float Error;

        /// <summary>Duration of the motion or cycle, s.</summary>
        public float Duration;

        /// <summary>
        /// Root x, y, z, then x, y, z, w per joint; for the encoding weights, one number per example.
        /// </summary>
        public float[] Values = new float[0];

        /// <summary>Whether the adverbs were outside the domain and were clamped to it.</summary>
        public bool Clamped { get { return (Flags & 1) != 0; } }

        /// <summary>Whether a transition between two verbs is in progress.</summary>
        public bool InTransition { get { return (Flags & 2) != 0; } }

        /// <summary>Whether the motion is at its end.</summary>
        public bool Last { get { return (Flags & 8) != 0; } }

        /// <summary>How well the examples support the pose, 0 to 1; NaN unless requested.</summary>
        public double Support { get { return Flags >> 4 == 0 ? double.NaN : ((Flags >> 4) - 1) / 14.0; } }

        internal void CopyFrom(WireRecord other)
        {
            Channel = other.Channel;
            Encoding = other.Encoding;
            Flags = other.Flags;
            Version = other.Version;
            Phase = other.Phase;
            Time = other.Time;
            Error = other.Error;
            Duration = other.Duration;
            if (Values.Length != other.Values.Length) Values = new float[other.Values.Length];
            Buffer.BlockCopy(other.Values, 0, Values, 0, 4 * Values.Length);
        }
    }

    /// <summary>The records of all channels that were due at one tick; reading another message reuses it.</summary>
    public sealed class PoseMessage
    {
        /// <summary>Number of the message in its session, modulo 2³².</summary>
        public uint Sequence;

        /// <summary>Messages of the session so far that were due and not sent, or lost with a connection.</summary>
        public uint Dropped;

        /// <summary>Due time on the server's clock, ns.</summary>
        public ulong TimeNs;

        /// <summary>Number of records.</summary>
        public int Count;

        readonly List<WireRecord> _records = new List<WireRecord>();

        /// <summary>Record k, 0 … Count − 1.</summary>
        public WireRecord this[int k] { get { return _records[k]; } }

        /// <summary>Reads a pose message. Nothing is allocated once the arrays have the size of the records.</summary>
        /// <param name="content">The message, from its first byte.</param>
        /// <param name="length">Its length.</param>
        /// <param name="layouts">Layouts of the open channels by number.</param>
        /// <exception cref="AdverbException">It is malformed, or a channel is not open: <c>malformed</c>.</exception>
        public void Read(byte[] content, int length, Dictionary<int, WireLayout> layouts)
        {
            Count = 0;
            if (length < 20 || content[0] != 0x01 || content[1] != 1)
                throw new AdverbException("malformed", "not a pose message of wire version 1");
            int records = content[2] | content[3] << 8, at = 20;
            for (int k = 0; k < records; k++)
            {
                if (length - at < 24) throw new AdverbException("malformed", "a record's header is cut off");
                int channel = content[at] | content[at + 1] << 8;
                WireLayout layout;
                if (!layouts.TryGetValue(channel, out layout))
                    throw new AdverbException("malformed", "a record of channel " + channel + ", which is not open");
                if (k == _records.Count) _records.Add(new WireRecord());
                at = Wire.ReadRecord(content, length, at, layout, _records[k]);
            }
            if (at != length) throw new AdverbException("malformed", "bytes after the last record");
            Sequence = BitConverter.ToUInt32(content, 4);
            TimeNs = BitConverter.ToUInt64(content, 8);
            Dropped = BitConverter.ToUInt32(content, 16);
            Count = records;
        }
    }

    /// <summary>Binary messages of docs/wire.md.</summary>
    public static class Wire
    {
        /// <summary>Longest message that a server accepts, bytes.</summary>
        public const int MaxMessageBytes = 65536;

        const double Root2 = 1.4142135623730951;

        static Wire()
        {
            if (!BitConverter.IsLittleEndian)
                throw new PlatformNotSupportedException("the client requires little-endian");
        }

        /// <summary>Reads one record; returns the offset of the next one.</summary>
        /// <exception cref="AdverbException">It is malformed: <c>malformed</c>.</exception>
        public static int ReadRecord(byte[] content, int length, int at, WireLayout layout, WireRecord into)
        {
            if (length - at < 28) throw new AdverbException("malformed", "a record is cut off");
            int encoding = content[at + 2], count = layout.Count;
            if (encoding != layout.Encoding)
                throw new AdverbException("malformed", "a record of encoding " + encoding + ", expected "
                    + layout.Encoding);
            if (encoding == Encodings.Weights) count = content[at + 24] | content[at + 25] << 8;
            int end = at + WireLayout.BytesOf(encoding, count);
            if (end > length) throw new AdverbException("malformed", "a record is cut off");
            into.Channel = content[at] | content[at + 1] << 8;
            into.Encoding = encoding;
            into.Flags = content[at + 3];
            into.Version = BitConverter.ToUInt32(content, at + 4);
            into.Phase = BitConverter.ToSingle(content, at + 8);
            into.Time = BitConverter.ToSingle(content, at + 12);
            into.Error = BitConverter.ToSingle(content, at + 16);
            into.Duration = BitConverter.ToSingle(content, at + 20);
            ReadValues(content, at + 24, encoding, count, into);
            if (!Finite(into.Phase) || !Finite(into.Time) || !Finite(into.Duration)) throw NotFinite();
            foreach (float value in into.Values) if (!Finite(value)) throw NotFinite();
            return end;
        }

        static void ReadValues(byte[] content, int at, int encoding, int count, WireRecord into)
        {
            int numbers = encoding == Encodings.Weights ? count : 3 + 4 * count;
            if (into.Values.Length != numbers) into.Values = new float[numbers];
            float[] values = into.Values;
            if (encoding == Encodings.Weights) Buffer.BlockCopy(content, at + 4, values, 0, 4 * numbers);
            else if (encoding == Encodings.F32) Buffer.BlockCopy(content, at, values, 0, 4 * numbers);
            else
            {
                Buffer.BlockCopy(content, at, values, 0, 12);
                at += 12;
                for (int j = 0; j < count; j++)
                    if (encoding == Encodings.Q48) ReadQ48(content, at + 6 * j, values, 3 + 4 * j);
                    else ReadQ32(BitConverter.ToUInt32(content, at + 4 * j), values, 3 + 4 * j);
            }
        }

        static void ReadQ48(byte[] content, int at, float[] values, int to)
        {
            int a = content[at] | content[at + 1] << 8, b = content[at + 2] | content[at + 3] << 8;
            int c = content[at + 4] | content[at + 5] << 8;
            const double scale = 1.0 / (16383 * Root2);
            Complete(((a & 0x7FFF) - 16383) * scale, ((b & 0x7FFF) - 16383) * scale, ((c & 0x7FFF) - 16383) * scale,
                (a >> 15) + 2 * (b >> 15), values, to);
        }

        static void ReadQ32(uint word, float[] values, int to)
        {
            const double scale = 1.0 / (511 * Root2);
            Complete(((int)(word & 0x3FF) - 511) * scale, ((int)(word >> 10 & 0x3FF) - 511) * scale,
                ((int)(word >> 20 & 0x3FF) - 511) * scale, (int)(word >> 30), values, to);
        }

        /// <summary>A unit quaternion of three components and the index of the omitted one.</summary>
        static void Complete(double a, double b, double c, int omitted, float[] values, int to)
        {
            double squared = a * a + b * b + c * c;
            if (squared > 1.0)
            {
                double scale = 1.0 / Math.Sqrt(squared);
                a *= scale;
                b *= scale;
                c *= scale;
                squared = 1.0;
            }
            double d = Math.Sqrt(1.0 - squared);
            values[to] = (float)(omitted == 0 ? d : a);
            values[to + 1] = (float)(omitted == 1 ? d : omitted < 1 ? a : b);
            values[to + 2] = (float)(omitted == 2 ? d : omitted < 2 ? b : c);
            values[to + 3] = (float)(omitted == 3 ? d : c);
        }

        /// <summary>Message 0x10: all adverbs of one channel.</summary>
        public static byte[] EncodeAdverbs(int channel, float[] adverbs)
        {
            var content = new byte[4 + 4 * adverbs.Length];
            content[0] = 0x10;
            content[2] = (byte)channel;
            content[3] = (byte)(channel >> 8);
            Check(channel, adverbs, 0, adverbs.Length, float.MaxValue);
            Buffer.BlockCopy(adverbs, 0, content, 4, 4 * adverbs.Length);
            return content;
        }

        /// <summary>Message 0x11: all adverbs of several channels, rows of equal length, at most 64 KiB.</summary>
        public static byte[] EncodeAdverbs(IList<int> channels, float[] adverbs)
        {
            int dims = channels.Count == 0 ? 0 : adverbs.Length / channels.Count, row = 4 + 4 * dims;
            if (dims == 0 || dims * channels.Count != adverbs.Length || 4 + row * channels.Count > MaxMessageBytes)
                throw new ArgumentException(adverbs.Length + " adverbs do not fit " + channels.Count + " channels");
            var content = new byte[4 + row * channels.Count];
            content[0] = 0x11;
            content[2] = (byte)channels.Count;
            content[3] = (byte)(channels.Count >> 8);
            for (int k = 0, at = 4; k < channels.Count; k++, at += row)
            {
                Check(channels[k], adverbs, k * dims, dims, 1e9f);
                content[at] = (byte)channels[k];
                content[at + 1] = (byte)(channels[k] >> 8);
                Buffer.BlockCopy(adverbs, 4 * dims * k, content, at + 4, 4 * dims);
            }
            return content;
        }

        static void Check(int channel, float[] adverbs, int start, int count, float most)
        {
            if (channel < 0 || channel > 65535)
                throw new ArgumentException("channel " + channel + " is not 0 to 65,535");
            for (int k = start; k < start + count; k++)
                if (!(Math.Abs(adverbs[k]) <= most))
                    throw new ArgumentException("an adverb is not finite or exceeds " + most);
        }

        static bool Finite(float value)
        {
            return !float.IsNaN(value) && !float.IsInfinity(value);
        }

        static AdverbException NotFinite()
        {
            return new AdverbException("malformed", "a record has a number that is not finite");
        }
    }

    /// <summary>
    /// Offset between the server's clock and this machine's: that of the ping with the shortest round trip in the last
    /// 60 s, which is within half of it.
    /// </summary>
    public sealed class ServerClock
    {
        const int MaxPings = 256;
        const double WindowS = 60.0;
        readonly Queue<double[]> _pings = new Queue<double[]>(); // arrival, round trip, offset
        double[] _best;

        /// <summary>Server's clock minus this machine's, seconds; NaN before the first ping.</summary>
        public double OffsetS { get { return _best == null ? double.NaN : _best[2]; } }

        /// <summary>Shortest round trip, seconds; NaN before the first ping.</summary>
        public double RoundTripS { get { return _best == null ? double.NaN : _best[1]; } }

        /// <summary>Adds a ping: times on this machine's monotonic clock, and the server's when it answered.</summary>
        public void Add(double sentS, double arrivedS, long serverTimeNs)
        {
            if (arrivedS < sentS) return;
            double middle = 0.5 * (sentS + arrivedS);
            _pings.Enqueue(new[] { arrivedS, arrivedS - sentS, serverTimeNs * 1e-9 - middle });
            while (_pings.Count > MaxPings || _pings.Peek()[0] < arrivedS - WindowS) _pings.Dequeue();
            _best = null;
            foreach (double[] ping in _pings) if (_best == null || ping[1] < _best[1]) _best = ping;
        }

        /// <summary>Discards all pings; another server has another clock.</summary>
        public void Clear()
        {
            _pings.Clear();
            _best = null;
        }
    }

    /// <summary>
    /// Lateness of messages: the 98 % quantile of their transits (arrival here minus due time there) minus the smallest
    /// transit, over the last 512. The offset between both clocks cancels. Safe for several threads.
    /// </summary>
    public sealed class Lateness
    {
        const double Quantile = 0.98;
        readonly double[] _transits = new double[512], _sorted = new double[512];
        long _count;
        bool _current;
        double _smallest, _late;

        /// <summary>Adds a message: its arrival on this machine's clock and its due time on the server's,
        /// seconds.</summary>
        public void Add(double arrivedS, double dueS)
        {
            lock (_transits)
            {
                _transits[_count++ % _transits.Length] = arrivedS - dueS;
                _current = false;
            }
        }

        /// <summary>Discards all messages.</summary>
        public void Clear()
        {
            lock (_transits)
            {
                _count = 0;
                _current = false;
            }
        }

        /// <summary>The smallest transit and the lateness, seconds; false before the first message.</summary>
        public bool Measure(out double smallestS, out double lateS)
        {
            lock (_transits)
            {
                int count = (int)Math.Min(_count, _transits.Length);
                if (!_current && count > 0)
                {
                    Array.Copy(_transits, _sorted, count);
                    Array.Sort(_sorted, 0, count);
                    _smallest = _sorted[0];
                    _late = _sorted[Math.Min(count - 1, (int)Math.Ceiling(Quantile * count))] - _smallest;
                    _current = true;
                }
                smallestS = count > 0 ? _smallest : double.NaN;
                lateS = count > 0 ? _late : 0.0;
                return count > 0;
            }
        }
    }

    /// <summary>Bounds of a jitter buffer, seconds.</summary>
    public sealed class Delays
    {
        /// <summary>Shortest delay.</summary>
        public double MinS = 0.0;

        /// <summary>Longest delay.</summary>
        public double MaxS = 0.25;

        /// <summary>Longest extrapolation past the last frame.</summary>
        public double ExtrapolateS = 0.1;
    }

    /// <summary>A pose at the displayed instant; its arrays are reused by the next sample.</summary>
    public sealed class AdverbPose
    {
        /// <summary>Displayed instant on the server's clock, seconds.</summary>
        public double ServerTimeS;

        /// <summary>Canonical time; within one cycle of a loop.</summary>
        public double Phase;

        /// <summary>Seconds from the start; within one cycle of a loop.</summary>
        public double TimeS;

        /// <summary>Duration of the motion or cycle, s.</summary>
        public double DurationS;

        /// <summary>Distance from the goal, m; NaN where nothing is measured.</summary>
        public double Error;

        /// <summary>Version of the verb.</summary>
        public uint Version;

        /// <summary>Whether the adverbs were clamped to the domain.</summary>
        public bool Clamped;

        /// <summary>Whether a transition is in progress.</summary>
        public bool InTransition;

        /// <summary>Whether the motion is at its end.</summary>
        public bool Ended;

        /// <summary>Root x, y, z, then x, y, z, w per joint; for the encoding weights, one number per
        /// example.</summary>
        public float[] Values = new float[0];

        /// <summary>Whether <see cref="Values"/> are weights.</summary>
        public bool IsWeights;

        /// <summary>Display delay, seconds.</summary>
        public double DelayS;

        /// <summary>Time past the last received frame, seconds.</summary>
        public double ExtrapolatedS;

        /// <summary>Whether that time is longer than the extrapolation, so that the motion is held.</summary>
        public bool Held;

        /// <summary>How well the examples support the pose, 0 to 1; NaN unless requested.</summary>
        public double Support;
    }

    /// <summary>
    /// Turns frames with irregular arrival times into poses at any display time. A pose is displayed later than its
    /// frame was due: by the interval between two frames and by the lateness of messages. Without new frames the
    /// motion is extrapolated for a short time and then held. One thread may push while another samples.
    /// </summary>
    public sealed class JitterBuffer
    {
        const int MaxFrames = 128;
        const double SnapS = 0.5, Slower = 0.20, Faster = 0.10, MaxStep = 3.5, GapDecay = 0.9;

        /// <summary>Time between two frames, seconds.</summary>
        public double IntervalS;

        /// <summary>Whether phases wrap around.</summary>
        public bool Looping;

        /// <summary>Frames that arrived after their display.</summary>
        public int Late;

        /// <summary>Frames that arrived twice.</summary>
        public int Duplicates;

        readonly Lateness _lateness;
        readonly Delays _delays;
        readonly double[] _times = new double[MaxFrames];
        readonly WireRecord[] _records = new WireRecord[MaxFrames];
        readonly object _lock = new object();
        int _count;
        double _gap, _lag = double.NaN, _sampled = double.NegativeInfinity, _shown = double.NegativeInfinity;
        bool _restartPending, _ending;
        float _endPhase = float.NaN;

        /// <summary>Makes a buffer.</summary>
        public JitterBuffer(Lateness lateness, double intervalS, Delays delays = null)
        {
            _lateness = lateness;
            IntervalS = intervalS;
            _delays = delays ?? new Delays();
            for (int k = 0; k < MaxFrames; k++) _records[k] = new WireRecord();
        }

        /// <summary>Number of frames.</summary>
        public int Count { get { lock (_lock) return _count; } }

        /// <summary>Phase of the newest frame; NaN where there is none.</summary>
        public double LastPhase { get { lock (_lock) return _count > 0 ? _records[_count - 1].Phase : double.NaN; } }

        /// <summary>Target delay: interval plus lateness, within the bounds.</summary>
        public double DelayS
        {
            get
            {
                double smallest, late;
                _lateness.Measure(out smallest, out late);
                return Math.Min(Math.Max(Spacing + late, _delays.MinS), _delays.MaxS);
            }
        }

        double Spacing { get { return Math.Max(IntervalS, _gap); } }

        /// <summary>Adds a frame, which is copied.</summary>
        /// <param name="dueS">Its due time on the server's clock.</param>
        /// <param name="record">The frame.</param>
        /// <param name="irregular">Whether a byte budget leaves frames out.</param>
        public void Push(double dueS, WireRecord record, bool irregular = false)
        {
            lock (_lock)
            {
                if (_restartPending) Forget();
                int at = After(dueS);
                if (at > 0 && _times[at - 1] == dueS)
                {
                    Duplicates++;
                    return;
                }
                double gap = _count > 0 && at == _count ? dueS - _times[_count - 1] : 0.0;
                _gap = irregular ? Math.Max(gap, GapDecay * _gap) : 0.0;
                if (dueS < _shown) Late++;
                Insert(at, dueS, record);
            }
        }

        /// <summary>Notes that the motion ends with the next frame.</summary>
        public void End()
        {
            lock (_lock) _ending = true;
        }

        /// <summary>Restarts at the next frame, which may be on another clock; until then the old frames are
        /// displayed.</summary>
        public void Restart()
        {
            lock (_lock) _restartPending = true;
        }

        /// <summary>The pose to display at a time; false before the first frame.</summary>
        /// <param name="nowS">On the clock of arrival times. An earlier time than the last one changes no
        /// state.</param>
        /// <param name="into">Written.</param>
        public bool Sample(double nowS, AdverbPose into)
        {
            lock (_lock)
            {
                if (_count == 0) return false;
                Playhead(nowS, into);
                Between(into);
                return true;
            }
        }

        /// <summary>Index after the last frame that is due at a time or before.</summary>
        int After(double dueS)
        {
            int at = _count;
            while (at > 0 && _times[at - 1] > dueS) at--;
            return at;
        }

        void Insert(int at, double dueS, WireRecord record)
        {
            if (_count == MaxFrames)
            {
                Drop();
                if (at == 0) return;
                at--;
            }
            WireRecord free = _records[_count];
            Array.Copy(_times, at, _times, at + 1, _count - at);
            Array.Copy(_records, at, _records, at + 1, _count - at);
            free.CopyFrom(record);
            Mark(free);
            _times[at] = dueS;
            _records[at] = free;
            _count++;
        }

        void Drop()
        {
            WireRecord first = _records[0];
            _count--;
            Array.Copy(_times, 1, _times, 0, _count);
            Array.Copy(_records, 1, _records, 0, _count);
            _records[_count] = first;
        }

        /// <summary>Sets the flag `last` also where the motion rests at its end; the server sets it in one
        /// record.</summary>
        void Mark(WireRecord record)
        {
            if (_ending || record.Last)
            {
                _ending = false;
                _endPhase = record.Phase;
            }
            if (record.Phase != _endPhase) _endPhase = float.NaN;
            else record.Flags |= 8;
        }

        void Forget()
        {
            _count = 0;
            _gap = 0.0;
            _lag = double.NaN;
            _sampled = _shown = double.NegativeInfinity;
            _restartPending = false;
            _endPhase = float.NaN;
        }

        void Playhead(double nowS, AdverbPose into)
        {
            double smallest, late;
            if (!_lateness.Measure(out smallest, out late) || _restartPending)
            {
                double held = double.IsNaN(_lag) ? nowS - _times[0] : _lag;
                into.ServerTimeS = nowS - held;
                into.DelayS = DelayS; // the clocks are not compared yet
                return;
            }
            double target = smallest + DelayS;
            if (double.IsNaN(_lag) || Math.Abs(target - _lag) > SnapS) _lag = target;
            else if (nowS > _sampled)
            {
                double passed = nowS - _sampled;
                _lag += Math.Min(Math.Max(target - _lag, -Faster * passed), Slower * passed);
            }
            _sampled = Math.Max(nowS, _sampled);
            into.ServerTimeS = nowS - _lag;
            into.DelayS = _lag - smallest;
            _shown = Math.Max(into.ServerTimeS, _shown);
        }

        void Between(AdverbPose into)
        {
            double shown = into.ServerTimeS;
            into.ExtrapolatedS = 0.0;
            int at = After(shown), last = _count - 1;
            if (at == 0)
            {
                into.ServerTimeS = _times[0];
                Blend(_records[0], _records[0], 0.0, into);
            }
            else if (at < _count)
                Blend(_records[at - 1], _records[at], (shown - _times[at - 1]) / (_times[at] - _times[at - 1]), into);
            else
            {
                into.ExtrapolatedS = shown - _times[last];
                double step = last > 0 ? _times[last] - _times[last - 1] : double.PositiveInfinity;
                if (step > MaxStep * Spacing || _records[last].Last) Blend(_records[last], _records[last], 1.0, into);
                else
                    Blend(_records[last - 1], _records[last],
                        1.0 + Math.Min(into.ExtrapolatedS, _delays.ExtrapolateS) / step, into);
            }
            into.Held = into.ExtrapolatedS > _delays.ExtrapolateS;
        }

        /// <summary>Interpolates two frames; a share above 1 extrapolates past the second.</summary>
        void Blend(WireRecord a, WireRecord b, double share, AdverbPose into)
        {
            WireRecord near = share < 0.5 ? a : b;
            SetPhase(a, b, share, into);
            into.Error = float.IsNaN(a.Error + b.Error) || share > 1.0 ? near.Error : Lerp(a.Error, b.Error, share);
            into.DurationS = Lerp(a.Duration, b.Duration, Math.Min(share, 1.0));
            into.Version = near.Version;
            into.Clamped = near.Clamped;
            into.InTransition = near.InTransition;
            into.Ended = near.Last;
            into.Support = near.Support;
            into.IsWeights = near.Encoding == Encodings.Weights;
            int count = near.Values.Length;
            if (into.Values.Length != count) into.Values = new float[count];
            if (a == b || a.Values.Length != b.Values.Length
                || (a.Encoding == Encodings.Weights) != (b.Encoding == Encodings.Weights))
            {
                Buffer.BlockCopy(near.Values, 0, into.Values, 0, 4 * count);
                return;
            }
            int linear = into.IsWeights ? count : 3;
            for (int k = 0; k < linear; k++) into.Values[k] = (float)Lerp(a.Values[k], b.Values[k], share);
            for (int k = linear; k < count; k += 4) Quat.Slerp(a.Values, b.Values, k, share, into.Values);
        }

        /// <summary>Phase and seconds, across the end of a loop where that is shorter.</summary>
        void SetPhase(WireRecord a, WireRecord b, double share, AdverbPose into)
        {
            if (!Looping)
            {
                into.Phase = Math.Min(Math.Max(Lerp(a.Phase, b.Phase, share), 0.0), 1.0);
                into.TimeS = Math.Min(Math.Max(Lerp(a.Time, b.Time, share), 0.0), Math.Max(a.Duration, b.Duration));
                return;
            }
            double wrap = Math.Round((double)a.Phase - b.Phase);
            into.Phase = Rest(Lerp(a.Phase, b.Phase + wrap, share), 1.0);
            into.TimeS = b.Duration > 0.0f ? Rest(Lerp(a.Time, b.Time + wrap * b.Duration, share), b.Duration) : 0.0;
        }

        static double Rest(double value, double divisor)
        {
            return value - divisor * Math.Floor(value / divisor);
        }

        static double Lerp(double a, double b, double share)
        {
            return a + share * (b - a);
        }
    }

    /// <summary>Settings of a channel; null leaves them as they are, or is the server's default.</summary>
    public class ChannelSettings
    {
        /// <summary>Goal: adverbs by name; all of them in <see cref="AdverbStream.OpenAsync"/>, any in
        /// <c>Set</c>.</summary>
        public IDictionary<string, double> Adverbs;

        /// <summary>Speed, −10 to 10.</summary>
        public double? Speed;

        /// <summary>Phase 0–1; it seeks at once.</summary>
        public double? Phase;

        /// <summary>Half life of the way to a goal, 0–10 s.</summary>
        public double? HalfLife;

        /// <summary>Share of a byte budget.</summary>
        public double? Priority;

        /// <summary>Whether the motion plays or is paused.</summary>
        public bool? Play;

        /// <summary>Whether the motion starts again.</summary>
        public bool? Loop;

        /// <summary>Whether a paused effector follows its goal.</summary>
        public bool? Follow;

        /// <summary>Frames per second, 1–120.</summary>
        public int? Fps;

        internal virtual Dictionary<string, object> Fields()
        {
            var fields = new Dictionary<string, object>(StringComparer.Ordinal);
            Options.Add(fields, "adverbs", Adverbs == null ? null : new Dictionary<string, double>(Adverbs));
            Options.Add(fields, "speed", Speed);
            Options.Add(fields, "phase", Phase);
            Options.Add(fields, "half_life", HalfLife);
            Options.Add(fields, "priority", Priority);
            Options.Add(fields, "play", Play);
            Options.Add(fields, "loop", Loop);
            Options.Add(fields, "follow", Follow);
            Options.Add(fields, "fps", Fps);
            return fields;
        }
    }

    /// <summary>Options of a new channel.</summary>
    public sealed class OpenOptions : ChannelSettings
    {
        /// <summary>Method of the verb.</summary>
        public string Method;

        /// <summary><c>local</c> or <c>global</c> rotations.</summary>
        public string Space;

        /// <summary><c>f32</c>, <c>q48</c>, <c>q32</c> or <c>weights</c>.</summary>
        public string Encoding;

        /// <summary><c>gltf</c>, <c>unity</c>, <c>unreal</c> or <c>zup</c>.</summary>
        public string Frame;

        /// <summary>Joints to receive.</summary>
        public string[] Joints;

        /// <summary>Whether standing feet stay.</summary>
        public bool? Plant;

        /// <summary>Whether keytimes are events.</summary>
        public bool? Events;

        /// <summary>Whether poses have the support.</summary>
        public bool? Support;

        internal override Dictionary<string, object> Fields()
        {
            Dictionary<string, object> fields = base.Fields();
            Options.Add(fields, "method", Method);
            Options.Add(fields, "space", Space);
            Options.Add(fields, "encoding", Encoding);
            Options.Add(fields, "frame", Frame);
            Options.Add(fields, "joints", Joints);
            Options.Add(fields, "plant", Plant);
            Options.Add(fields, "events", Events);
            Options.Add(fields, "support", Support);
            return fields;
        }
    }

    /// <summary>Kinds of events.</summary>
    public enum StreamEventKind
    {
        /// <summary>A channel was opened, switched or resumed.</summary>
        Opened,
        /// <summary>A new version of the channel's verb.</summary>
        Version,
        /// <summary>The motion passes a keytime.</summary>
        Keytime,
        /// <summary>A motion that does not loop is at its end.</summary>
        End,
        /// <summary>Report of the byte budget.</summary>
        Stats,
        /// <summary>The server rejects a setting; nothing else changes.</summary>
        Error,
        /// <summary>The server is about to stop; the stream reconnects.</summary>
        Drain,
        /// <summary>The connection is lost; the stream reconnects.</summary>
        Lost,
        /// <summary>The connection is restored.</summary>
        Restored,
        /// <summary>The stream is closed for good: the last event, unless <see cref="AdverbStream.SetKey"/> connects it
        /// again.</summary>
        Closed,
    }

    /// <summary>Something that a stream reports besides poses.</summary>
    public sealed class StreamEvent
    {
        /// <summary>Kind of event.</summary>
        public StreamEventKind Kind;

        /// <summary>Number of the channel; −1 where it concerns none.</summary>
        public int Channel = -1;

        /// <summary>Name of a keytime; verb of <c>Opened</c>.</summary>
        public string Name;

        /// <summary>Phase of a keytime.</summary>
        public double Phase;

        /// <summary>New version.</summary>
        public long Version;

        /// <summary>Error of <c>Error</c> and <c>Closed</c>.</summary>
        public AdverbException Error;

        /// <summary>Explanation.</summary>
        public string Detail;

        /// <summary>Close code of the connection; 0 where there is none.</summary>
        public int CloseCode;

        /// <summary>Whether the session is resumed, or its channels are opened in a new one.</summary>
        public bool Resumed;

        /// <summary>Seconds without a connection.</summary>
        public double OutageS;

        /// <summary>Fields of <c>Stats</c>.</summary>
        public Dictionary<string, object> Fields;
    }

    /// <summary>Counters of a stream.</summary>
    public sealed class StreamStats
    {
        /// <summary>Pose messages.</summary>
        public long Messages;

        /// <summary>Records of pose messages.</summary>
        public long Records;

        /// <summary>Bytes of all received messages.</summary>
        public long Bytes;

        /// <summary>Jumps of the sequence number.</summary>
        public long Gaps;

        /// <summary>Sequence numbers that are missing.</summary>
        public long Missing;

        /// <summary>Messages that a newer one overtook.</summary>
        public long Stale;

        /// <summary>Messages that were not sent, or were lost with a connection, as the server reports.</summary>
        public long Dropped;

        /// <summary>Malformed messages.</summary>
        public long DecodeErrors;

        /// <summary>Reason of the last malformed message.</summary>
        public string LastError = "";

        /// <summary>Connections after the first.</summary>
        public long Reconnects;

        /// <summary>Connections that resumed the session.</summary>
        public long Resumes;

        /// <summary>Events that were discarded because the queue was full.</summary>
        public long EventsDropped;
    }

    /// <summary>What a message <c>opened</c> states of a channel.</summary>
    public sealed class ChannelInfo
    {
        /// <summary>Name of the verb.</summary>
        public string Verb;

        /// <summary>Method of the weights.</summary>
        public string Method;

        /// <summary>Name of the encoding.</summary>
        public string Encoding;

        /// <summary><c>local</c> or <c>global</c> rotations.</summary>
        public string Space;

        /// <summary>Name of the frame.</summary>
        public string Frame;

        /// <summary>Version of the verb.</summary>
        public long Version;

        /// <summary>Joints, in the channel's frame.</summary>
        public Skeleton Skeleton;

        /// <summary>Adverbs in the order of <see cref="AdverbChannel.Aim"/>.</summary>
        public AdverbInfo[] Adverbs;

        /// <summary>Joints of a record, in its order.</summary>
        public string[] Joints;

        /// <summary>Frames per second.</summary>
        public double Fps;

        /// <summary>Whether the motion loops.</summary>
        public bool Looping;

        /// <summary>Keytimes by name.</summary>
        public Dictionary<string, double> Keytimes;

        /// <summary>Phases in which a paused effector is on its goal: from, to; null where there are none.</summary>
        public double[] Follow;

        /// <summary>Layout of the records.</summary>
        public WireLayout Layout;

        /// <summary>Whether the message answers <c>resume</c>.</summary>
        public bool Resumed;

        internal static ChannelInfo Of(Dictionary<string, object> fields)
        {
            var found = new ChannelInfo
            {
                Verb = Json.Text(fields, "verb"),
                Method = Json.Text(fields, "method"),
                Encoding = Json.Text(fields, "encoding"),
                Space = Json.Text(fields, "space"),
                Frame = Json.Text(fields, "frame"),
                Version = Json.Integer(fields, "version"),
                Skeleton = Skeleton.Of(Json.AsObject(Json.Get(fields, "skeleton"), "skeleton")),
                Adverbs = AdverbInfo.Of(Json.Items(fields, "adverbs")),
                Joints = Json.Texts(fields, "joints"),
                Fps = Json.Number(fields, "fps"),
                Looping = Json.Flag(fields, "looping"),
                Keytimes = new Dictionary<string, double>(StringComparer.Ordinal),
                Resumed = Json.Flag(fields, "resumed"),
            };
            if (!(found.Fps > 0.0)) throw new AdverbException("malformed", "fps is not positive");
            foreach (object each in Json.Items(fields, "keytimes"))
            {
                Dictionary<string, object> row = Json.AsObject(each, "a keytime");
                found.Keytimes[Json.Text(row, "name")] = Json.Number(row, "phase");
            }
            var follow = Json.Get(fields, "follow") as List<object>;
            if (follow != null && follow.Count == 2)
                found.Follow = new[] { Json.Number(follow[0], "follow"), Json.Number(follow[1], "follow") };
            int bytes = (int)Json.Integer(fields, "record_bytes");
            found.Layout = WireLayout.Of(found.Encoding, found.Joints.Length, bytes);
            return found;
        }
    }

    /// <summary>
    /// One character of a stream. Methods never block and may be called from any thread; settings made without a
    /// connection are sent after the reconnection, and those of a closed channel have no effect.
    /// </summary>
    public sealed class AdverbChannel
    {
        static readonly string[] Settings = { "adverbs", "speed", "play", "loop", "fps", "half_life", "follow",
            "priority" };

        /// <summary>Number, 0 … 65,535.</summary>
        public readonly int Number;

        /// <summary>Why the channel could not be opened again after a reconnection; null if it could.</summary>
        public AdverbException Error { get; internal set; }

        /// <summary>The server's latest description of the channel.</summary>
        public ChannelInfo Info { get; internal set; }

        /// <summary>Whether a switch has no answer so far.</summary>
        public bool Switching { get { lock (_stream.Gate) return Switch != null; } }

        internal readonly JitterBuffer Buffer;
        internal readonly SemaphoreSlim Requests = new SemaphoreSlim(1, 1);
        internal TaskCompletionSource<AdverbException> Pending;
        internal Dictionary<string, object> Switch; // sent, without an answer so far
        internal double PendingPhase = double.NaN; // set; the server may not have it

        readonly AdverbStream _stream;
        readonly Dictionary<string, object> _desired;
        Dictionary<string, double> _adverbs; // goal by name; maybe not all
        Dictionary<string, double> _deferred; // set during a switch
        bool _allAdverbs, _aimed;
        float[] _goal = new float[0]; // newer than _adverbs where _aimed
        float[] _deferredAim;

        internal AdverbChannel(AdverbStream stream, int number, string verb, OpenOptions options, JitterBuffer buffer)
        {
            _stream = stream;
            Number = number;
            Buffer = buffer;
            _desired = options.Fields();
            _desired["verb"] = verb;
            object phase;
            if (_desired.TryGetValue("phase", out phase)) PendingPhase = (double)phase;
            _desired.Remove("phase");
            _adverbs = TakeAdverbs(_desired);
            _allAdverbs = _adverbs != null;
        }

        /// <summary>The pose to display now; false before the first frame.</summary>
        public bool Sample(AdverbPose into)
        {
            return Buffer.Sample(_stream.NowS, into);
        }

        /// <summary>The pose to display at a time of <see cref="AdverbStream.NowS"/>.</summary>
        public bool Sample(double nowS, AdverbPose into)
        {
            return Buffer.Sample(nowS, into);
        }

        /// <summary>Sets the goal: all adverbs in the order of <see cref="ChannelInfo.Adverbs"/>; 4 + 4·D
        /// bytes.</summary>
        public void Aim(params float[] adverbs)
        {
            byte[] content = Wire.EncodeAdverbs(Number, adverbs);
            lock (_stream.Gate)
                if (_stream.Has(this) && Keep(adverbs, 0, adverbs.Length)) _stream.Post(Outbox.Aim, Number, content);
        }

        /// <summary>Changes the given settings.</summary>
        public void Set(ChannelSettings settings)
        {
            Dictionary<string, object> changed = settings.Fields();
            if (changed.Count == 0) return;
            Json.Write(changed); // refuses numbers that are not finite
            lock (_stream.Gate)
            {
                if (!_stream.Has(this)) return;
                Dictionary<string, double> adverbs = TakeAdverbs(changed);
                if (adverbs != null) Merge(adverbs);
                foreach (KeyValuePair<string, object> each in changed)
                    if (each.Key == "phase") PendingPhase = (double)each.Value;
                    else _desired[each.Key] = each.Value;
                if (settings.Fps != null) Buffer.IntervalS = 1.0 / settings.Fps.Value;
                changed["op"] = "set";
                changed["channel"] = Number;
                if (adverbs != null) changed["adverbs"] = adverbs;
                _stream.Post(Outbox.Set, Number, changed);
            }
        }

        static Dictionary<string, double> TakeAdverbs(Dictionary<string, object> fields)
        {
            object found;
            fields.TryGetValue("adverbs", out found);
            fields.Remove("adverbs");
            return (Dictionary<string, double>)found;
        }

        /// <summary>Keeps a goal for a reconnection; returns whether it is to be sent now.</summary>
        internal bool Keep(float[] adverbs, int start, int count)
        {
            if (Info == null || Switch != null)
            {
                _deferredAim = new float[count]; // the next verb's number of adverbs is not known yet
                Array.Copy(adverbs, start, _deferredAim, 0, count);
                return false;
            }
            if (count != Info.Adverbs.Length)
                throw new ArgumentException(count + " adverbs given; " + Info.Verb + " has " + Info.Adverbs.Length);
            if (_goal.Length != count) _goal = new float[count];
            Array.Copy(adverbs, start, _goal, 0, count);
            return _aimed = true;
        }

        void Merge(Dictionary<string, double> adverbs)
        {
            Fold();
            Dictionary<string, double> known = Switch != null ? _deferred : _adverbs;
            if (known == null) known = new Dictionary<string, double>(StringComparer.Ordinal);
            foreach (KeyValuePair<string, double> each in adverbs) known[each.Key] = each.Value;
            if (Switch != null) _deferred = known;
            else _adverbs = known;
        }

        /// <summary>Makes the goal of the last aim the goal by name.</summary>
        void Fold()
        {
            if (!_aimed || Info == null) return;
            _aimed = false;
            _adverbs = new Dictionary<string, double>(StringComparer.Ordinal);
            for (int k = 0; k < _goal.Length; k++) _adverbs[Info.Adverbs[k].Name] = _goal[k];
            _allAdverbs = true;
        }

        internal void ApplyOpened(ChannelInfo opened)
        {
            bool restarted = Info == null || Switch == null && !opened.Resumed;
            Info = opened;
            Error = null;
            if (Switch != null && opened.Verb == (string)Switch["verb"]) CommitSwitch();
            Buffer.IntervalS = 1.0 / opened.Fps;
            Buffer.Looping = opened.Looping;
            if (restarted) Buffer.Restart();
            if (_deferredAim == null || Switch != null) return;
            float[] aimed = _deferredAim;
            _deferredAim = null;
            if (aimed.Length == opened.Adverbs.Length) Aim(aimed);
        }

        /// <summary>Makes the verb, adverbs and method of the pending switch those of the channel.</summary>
        internal void CommitSwitch()
        {
            if (Switch == null) return;
            _aimed = false;
            _desired["verb"] = Switch["verb"];
            _desired.Remove("method");
            if (Switch.ContainsKey("method")) _desired["method"] = Switch["method"];
            object adverbs;
            Switch.TryGetValue("adverbs", out adverbs);
            _allAdverbs = adverbs != null;
            _adverbs = adverbs == null ? null : new Dictionary<string, double>((Dictionary<string, double>)adverbs);
            Dictionary<string, double> deferred = _deferred;
            ClearSwitch();
            if (deferred != null) Merge(deferred);
        }

        internal void ClearSwitch()
        {
            Switch = null;
            _deferred = null;
        }

        internal bool HasAllAdverbs { get { return _allAdverbs; } }

        /// <summary>The message that opens the channel with its current settings at its last known phase.</summary>
        internal Dictionary<string, object> OpenMessage()
        {
            Fold();
            var fields = new Dictionary<string, object>(_desired);
            fields["op"] = "open";
            fields["channel"] = Number;
            if (_allAdverbs) fields["adverbs"] = _adverbs;
            double last = Buffer.LastPhase;
            double phase = double.IsNaN(PendingPhase) ? Math.Min(Math.Max(last, 0.0), 1.0) : PendingPhase;
            if (!double.IsNaN(PendingPhase) || !double.IsNaN(last)) fields["phase"] = phase;
            return fields;
        }

        /// <summary>The message that applies all settings to a resumed channel; null where there are none.</summary>
        internal Dictionary<string, object> SetMessage()
        {
            Fold();
            var fields = new Dictionary<string, object>(StringComparer.Ordinal);
            foreach (string name in Settings) if (_desired.ContainsKey(name)) fields[name] = _desired[name];
            if (_adverbs != null) fields["adverbs"] = _adverbs;
            if (!double.IsNaN(PendingPhase)) fields["phase"] = PendingPhase;
            if (fields.Count == 0) return null;
            fields["op"] = "set";
            fields["channel"] = Number;
            return fields;
        }
    }

    /// <summary>Outgoing messages; a newer one replaces an unsent one with the same key. Used under the stream's
    /// lock.</summary>
    sealed class Outbox
    {
        internal const int None = 0, Aim = 1, Set = 2, View = 3, Crowd = 4;
        readonly LinkedList<KeyValuePair<long, object>> _messages = new LinkedList<KeyValuePair<long, object>>();
        readonly Dictionary<long, LinkedListNode<KeyValuePair<long, object>>> _nodes =
            new Dictionary<long, LinkedListNode<KeyValuePair<long, object>>>();
        readonly SemaphoreSlim _filled = new SemaphoreSlim(0, 1);
        long _next;

        internal void Put(int kind, long number, object message)
        {
            long key = kind == None ? -++_next : 8 * number + kind;
            LinkedListNode<KeyValuePair<long, object>> old;
            if (_nodes.TryGetValue(key, out old))
            {
                if (kind == Set)
                    message = Merged((Dictionary<string, object>)old.Value.Value, (Dictionary<string, object>)message);
                _messages.Remove(old);
            }
            _nodes[key] = _messages.AddLast(new KeyValuePair<long, object>(key, message));
            if (_filled.CurrentCount == 0) _filled.Release();
        }

        internal void Clear()
        {
            _messages.Clear();
            _nodes.Clear();
        }

        /// <summary>Removes unsent goals and settings of a channel, which its number's next channel would
        /// get.</summary>
        internal void Drop(long number)
        {
            LinkedListNode<KeyValuePair<long, object>> old;
            for (long key = 8 * number + Aim; key <= 8 * number + Set; key++)
            {
                if (!_nodes.TryGetValue(key, out old)) continue;
                _messages.Remove(old);
                _nodes.Remove(key);
            }
        }

        internal Task WaitAsync(CancellationToken cancel)
        {
            return _filled.WaitAsync(cancel);
        }

        internal void Take(List<object> into)
        {
            foreach (KeyValuePair<long, object> each in _messages) into.Add(each.Value);
            Clear();
        }

        static Dictionary<string, object> Merged(Dictionary<string, object> old, Dictionary<string, object> newer)
        {
            foreach (KeyValuePair<string, object> each in old)
            {
                if (!newer.ContainsKey(each.Key)) newer[each.Key] = each.Value;
                else if (each.Key == "adverbs")
                {
                    var adverbs = new Dictionary<string, double>((Dictionary<string, double>)each.Value);
                    foreach (KeyValuePair<string, double> one in (Dictionary<string, double>)newer["adverbs"])
                        adverbs[one.Key] = one.Value;
                    newer["adverbs"] = adverbs;
                }
            }
            return newer;
        }
    }

    /// <summary>
    /// A stream of poses: one WebSocket with any number of characters. It reconnects with growing delays and resumes
    /// its session; where that does not exist any more, the channels are opened again in their current state.
    /// </summary>
    public sealed class AdverbStream : IDisposable
    {
        const string Subprotocol = "adverb.v1", StreamPath = "/v1/stream";
        const int RevokedCode = 4401, ResumedElsewhere = 4009, MaxEvents = 1024, MaxPings = 64;
        const int MaxMessageBytes = 64 * 1024 * 1024;
        const double HelloTimeoutS = 10.0, StableAfterS = 5.0, MaxDrainS = 60.0;

        /// <summary>How long to try to reconnect, seconds.</summary>
        public double ReconnectTimeoutS = 120.0;

        /// <summary>A connection without any message for so long is broken and made again, seconds.</summary>
        public double SilenceS = 10.0;

        /// <summary>First delay between attempts, seconds; half of each is random.</summary>
        public double FirstDelayS = 0.1;

        /// <summary>Longest delay between attempts, seconds.</summary>
        public double MaxDelayS = 5.0;

        /// <summary>Whether the key is sent as a subprotocol, for platforms whose WebSocket has no headers.</summary>
        public bool KeyAsSubprotocol;

        /// <summary>Counters.</summary>
        public readonly StreamStats Stats = new StreamStats();

        /// <summary>Estimate of the server's clock.</summary>
        public readonly ServerClock Clock = new ServerClock();

        internal readonly object Gate = new object();

        readonly Uri _uri;
        readonly string _root;
        readonly Delays _delays;
        readonly Lateness _lateness = new Lateness();
        readonly Outbox _outbox = new Outbox();
        readonly Queue<StreamEvent> _events = new Queue<StreamEvent>();
        readonly SortedDictionary<int, AdverbChannel> _channels = new SortedDictionary<int, AdverbChannel>();
        readonly Dictionary<int, WireLayout> _layouts = new Dictionary<int, WireLayout>();
        readonly HashSet<int> _confirmed = new HashSet<int>(), _notReady = new HashSet<int>();
        readonly Dictionary<long, double> _pings = new Dictionary<long, double>();
        readonly PoseMessage _message = new PoseMessage();
        readonly CancellationTokenSource _closing = new CancellationTokenSource();
        readonly TaskCompletionSource<bool> _ready =
            new TaskCompletionSource<bool>(TaskCreationOptions.RunContinuationsAsynchronously);
        readonly Random _random = new Random();
        Task _task;
        AdverbException _ended;
        string _key, _session = "", _failure = "not connected yet";
        uint _sequence;
        long _droppedBefore, _lastPing, _barrier;
        bool _live, _connected;
        int _closeCode, _failures;
        double _receivedS, _lostS = double.NaN, _drainS;
        Dictionary<string, object> _hello, _view;

        /// <summary>Makes a stream; <see cref="ConnectAsync"/> connects it.</summary>
        /// <param name="baseUrl">Address of the server: http, https, ws or wss, host and port, and the path where a
        /// proxy gives it one.</param>
        /// <param name="key">Key; null where the server requires none.</param>
        /// <param name="delays">Bounds of the jitter buffers.</param>
        public AdverbStream(string baseUrl, string key = null, Delays delays = null)
        {
            var given = new Uri(baseUrl);
            bool secure = given.Scheme == "https" || given.Scheme == "wss";
            if (!secure && given.Scheme != "http" && given.Scheme != "ws")
                throw new ArgumentException("expected http://, https://, ws:// or wss://, got " + baseUrl);
            string path = given.AbsolutePath.TrimEnd('/');
            if (path.EndsWith(StreamPath, StringComparison.Ordinal))
                path = path.Substring(0, path.Length - StreamPath.Length);
            _uri = new Uri((secure ? "wss://" : "ws://") + given.Authority + path + StreamPath + given.Query);
            _root = (secure ? "https://" : "http://") + given.Authority + path;
            _key = key;
            _delays = delays ?? new Delays();
        }

        /// <summary>Monotonic clock of the stream, seconds.</summary>
        public double NowS { get { return Stopwatch.GetTimestamp() / (double)Stopwatch.Frequency; } }

        /// <summary>Whether there is a connection.</summary>
        public bool Live { get { lock (Gate) return _live; } }

        /// <summary>Why the stream has ended; null while it has not.</summary>
        public AdverbException Ended { get { lock (Gate) return _ended; } }

        /// <summary>Connects; attempts are repeated until the timeout.</summary>
        /// <exception cref="AdverbException"><c>unauthenticated</c>, <c>missing_scope</c>; <c>offline</c> where there
        /// is no connection in time.</exception>
        public async Task ConnectAsync(double timeoutS = 10.0)
        {
            if (_task != null)
                throw new InvalidOperationException("a stream is connected once; it reconnects by itself");
            _task = Task.Run(RunAsync);
            await Task.WhenAny(_ready.Task, _task, Task.Delay(TimeSpan.FromSeconds(timeoutS))).ConfigureAwait(false);
            AdverbException ended = Ended;
            if (ended != null) throw ended;
            if (_ready.Task.IsCompleted) return;
            string failure = _failure;
            await CloseAsync().ConfigureAwait(false);
            throw new AdverbException("offline", _uri + ": no stream within " + timeoutS + " s: " + failure);
        }

        /// <summary>Sets the key of the next connections (null: none). A stream that has ended because its key was
        /// refused connects again, and continues with its channels in their current state.</summary>
        public void SetKey(string key)
        {
            lock (Gate)
            {
                _key = key;
                if (_ended == null || !IsRefusal(_ended) || _closing.IsCancellationRequested) return;
                _ended = null;
                _failures = 0;
                _ready.TrySetResult(true); // no ConnectAsync waits; ReconnectTimeoutS holds from now on
                _task = Task.Run(RunAsync);
            }
        }

        static bool IsRefusal(AdverbException error)
        {
            return error.Status == 401 || error.Status == 403;
        }

        /// <summary>Closes the stream and its channels; received poses stay readable.</summary>
        public async Task CloseAsync()
        {
            _closing.Cancel();
            if (_task != null) await _task.ConfigureAwait(false);
        }

        /// <summary>Closes the stream, without a wait for its end.</summary>
        public void Dispose()
        {
            _closing.Cancel();
        }

        /// <summary>Takes the next event; false where there is none.</summary>
        public bool TryTakeEvent(out StreamEvent found)
        {
            lock (Gate)
            {
                found = _events.Count > 0 ? _events.Dequeue() : null;
                return found != null;
            }
        }

        /// <summary>Opens a channel: one character that plays a verb.</summary>
        /// <param name="verb">Name of the verb.</param>
        /// <param name="options">Settings.</param>
        /// <param name="number">Number of the channel; −1: the smallest free one.</param>
        /// <param name="timeoutS">Longest wait for the answer, with the time in which the server loads its
        /// verbs.</param>
        /// <exception cref="AdverbException">The server rejects it, or does not answer in time.</exception>
        public async Task<AdverbChannel> OpenAsync(string verb, OpenOptions options = null, int number = -1,
            double timeoutS = 10.0)
        {
            AdverbChannel channel;
            options = options ?? new OpenOptions();
            lock (Gate)
            {
                while (number < 0 && _channels.ContainsKey(~number)) number--;
                if (number < 0) number = ~number;
                if (number > 65535 || _channels.ContainsKey(number))
                    throw new ArgumentException("channel " + number + " is open already, or not 0 to 65,535");
                var buffer = new JitterBuffer(_lateness, 1.0 / (options.Fps ?? 60), _delays);
                channel = new AdverbChannel(this, number, verb, options, buffer);
                Json.Write(channel.OpenMessage()); // refuses numbers that are not finite
                _channels[number] = channel;
            }
            try
            {
                await RequestAsync(channel, channel.OpenMessage, timeoutS, true).ConfigureAwait(false);
            }
            catch
            {
                lock (Gate) if (Has(channel)) _channels.Remove(number);
                throw;
            }
            return channel;
        }

        /// <summary>Switches a channel to another verb, with a continuous transition.</summary>
        /// <exception cref="AdverbException">The server rejects it; the channel keeps its verb.</exception>
        public async Task<ChannelInfo> SwitchAsync(AdverbChannel channel, string verb,
            IDictionary<string, double> adverbs = null, string method = null, double? phase = null,
            double? transitionS = null, double timeoutS = 10.0)
        {
            Dictionary<string, object> fields = Message("switch", "channel", channel.Number);
            fields["verb"] = verb;
            Options.Add(fields, "adverbs", adverbs == null ? null : new Dictionary<string, double>(adverbs));
            Options.Add(fields, "method", method);
            Options.Add(fields, "phase", phase);
            Options.Add(fields, "transition_s", transitionS);
            Json.Write(fields);
            await channel.Requests.WaitAsync().ConfigureAwait(false);
            try
            {
                lock (Gate) channel.Switch = fields;
                await ExchangeAsync(channel, () => fields, timeoutS, false).ConfigureAwait(false);
            }
            finally
            {
                lock (Gate) channel.ClearSwitch();
                channel.Requests.Release();
            }
            return channel.Info;
        }

        /// <summary>Closes a channel; its received poses stay readable.</summary>
        public void Close(AdverbChannel channel)
        {
            lock (Gate)
            {
                if (!Has(channel)) return;
                _channels.Remove(channel.Number);
                _outbox.Drop(channel.Number);
                Post(Outbox.None, 0, Message("close", "channel", channel.Number));
            }
        }

        /// <summary>Whether a channel is not closed; a later one may have its number.</summary>
        internal bool Has(AdverbChannel channel)
        {
            AdverbChannel found;
            return _channels.TryGetValue(channel.Number, out found) && found == channel;
        }

        /// <summary>Sets the goals of many channels with one message of 4 + B·(4 + 4·D) bytes.</summary>
        /// <param name="channels">B channels whose verbs have D adverbs.</param>
        /// <param name="adverbs">B rows of D numbers.</param>
        public void AimMany(IList<AdverbChannel> channels, float[] adverbs)
        {
            if (channels.Count == 0) return;
            int dims = adverbs.Length / channels.Count, most = (Wire.MaxMessageBytes - 4) / (4 + 4 * dims);
            if (dims == 0 || dims * channels.Count != adverbs.Length)
                throw new ArgumentException(adverbs.Length + " adverbs do not fit " + channels.Count + " channels");
            for (int start = 0; start < channels.Count; start += most)
            {
                int count = Math.Min(most, channels.Count - start);
                var numbers = new List<int>(count);
                var rows = new float[dims * count];
                long key = 17;
                lock (Gate)
                {
                    for (int k = 0; k < count; k++)
                    {
                        AdverbChannel channel = channels[start + k];
                        if (!Has(channel) || !channel.Keep(adverbs, dims * (start + k), dims)) continue;
                        Array.Copy(adverbs, dims * (start + k), rows, dims * numbers.Count, dims);
                        numbers.Add(channel.Number);
                        key = unchecked((key ^ channel.Number) * 1099511628211L);
                    }
                    if (numbers.Count == 0) continue;
                    Array.Resize(ref rows, dims * numbers.Count);
                    Post(Outbox.Crowd, key & long.MaxValue >> 3, Wire.EncodeAdverbs(numbers, rows));
                }
            }
        }

        /// <summary>Sets the viewpoint (m; null: none) and the byte budget (kbps; null: unlimited) of the
        /// stream.</summary>
        public void View(double[] position = null, double? budgetKbps = null)
        {
            var view = new Dictionary<string, object> { { "op", "view" } };
            for (int k = 0; position != null && k < 3; k++) view["xyz".Substring(k, 1)] = position[k];
            Options.Add(view, "budget_kbps", budgetKbps);
            Json.Write(view);
            lock (Gate)
            {
                _view = view;
                Post(Outbox.View, 0, view);
            }
        }

        // --- requests ---

        async Task RequestAsync(AdverbChannel channel, Func<Dictionary<string, object>> message, double timeoutS,
            bool retry)
        {
            await channel.Requests.WaitAsync().ConfigureAwait(false);
            try
            {
                await ExchangeAsync(channel, message, timeoutS, retry).ConfigureAwait(false);
            }
            finally
            {
                channel.Requests.Release();
            }
        }

        /// <summary>Sends a request and waits for its answer, also across a reconnection.</summary>
        async Task ExchangeAsync(AdverbChannel channel, Func<Dictionary<string, object>> message, double timeoutS,
            bool retry)
        {
            double end = NowS + timeoutS;
            try
            {
                while (true)
                {
                    Task<AdverbException> answer = SendRequest(channel, message);
                    double left = Math.Max(end - NowS, 0.0);
                    await Task.WhenAny(answer, Task.Delay(TimeSpan.FromSeconds(left))).ConfigureAwait(false);
                    if (!answer.IsCompleted)
                        throw new AdverbException("timed_out", "no answer for channel " + channel.Number + " in "
                            + timeoutS + " s");
                    AdverbException error = answer.Result;
                    if (error == null) return;
                    if (!retry || error.Code != "not_ready") throw error;
                    await Task.Delay(250).ConfigureAwait(false);
                }
            }
            finally
            {
                lock (Gate) channel.Pending = null;
            }
        }

        Task<AdverbException> SendRequest(AdverbChannel channel, Func<Dictionary<string, object>> message)
        {
            lock (Gate)
            {
                if (_task == null || _ended != null)
                    throw _ended ?? new AdverbException("closed", "the stream is not connected");
                if (!Has(channel)) throw new AdverbException("closed", "channel " + channel.Number + " is closed");
                channel.Pending = new TaskCompletionSource<AdverbException>(TaskCreationOptions.RunContinuationsAsynchronously);
                Post(Outbox.None, 0, message());
                return channel.Pending.Task;
            }
        }

        /// <summary>Queues a message while there is a session; otherwise settings are sent after the
        /// reconnection.</summary>
        internal void Post(int kind, long number, object message)
        {
            if (_live) _outbox.Put(kind, number, message);
        }

        void Send(Dictionary<string, object> message)
        {
            _outbox.Put(Outbox.None, 0, message);
        }

        static Dictionary<string, object> Message(string op, string name, object value)
        {
            return new Dictionary<string, object> { { "op", op }, { name, value } };
        }

        void Emit(StreamEvent found)
        {
            if (_events.Count >= MaxEvents)
            {
                _events.Dequeue();
                Stats.EventsDropped++;
            }
            _events.Enqueue(found);
        }

        // --- connection ---

        async Task RunAsync()
        {
            var end = new AdverbException("closed", "the stream was closed by this client");
            try
            {
                await ReconnectAsync().ConfigureAwait(false);
            }
            catch (AdverbException error)
            {
                end = error;
            }
            catch (Exception error)
            {
                if (!_closing.IsCancellationRequested)
                    end = new AdverbException("closed", "the stream failed: " + error, 0, null, error);
            }
            lock (Gate)
            {
                _live = false;
                _ended = end;
                foreach (AdverbChannel channel in _channels.Values) Answer(channel, end);
                Emit(new StreamEvent { Kind = StreamEventKind.Closed, Error = end, Detail = end.Detail,
                    CloseCode = _closeCode });
            }
        }

        async Task ReconnectAsync()
        {
            double disconnected = NowS;
            while (!_closing.IsCancellationRequested)
            {
                double began = NowS;
                _connected = false;
                await ConnectOnceAsync().ConfigureAwait(false);
                lock (Gate) Disconnected();
                if (_closing.IsCancellationRequested) return;
                if (!_connected || _closeCode == RevokedCode) await CheckAccessAsync().ConfigureAwait(false);
                if (_closeCode == ResumedElsewhere)
                    throw new AdverbException("closed", "another connection has resumed this session");
                if (_connected)
                {
                    disconnected = NowS;
                    if (disconnected - began > StableAfterS) _failures = 0;
                }
                else if (_ready.Task.IsCompleted && NowS - disconnected > ReconnectTimeoutS)
                    throw new AdverbException("offline", "no reconnection within " + ReconnectTimeoutS + " s: "
                        + _failure);
                double full = Math.Min(MaxDelayS, FirstDelayS * Math.Pow(2.0, Math.Min(_failures++, 30)));
                double delay = Math.Max(Math.Min(_drainS, MaxDrainS), full * (0.5 + 0.5 * _random.NextDouble()));
                _drainS = 0.0;
                await Task.Delay(TimeSpan.FromSeconds(delay), _closing.Token).ConfigureAwait(false);
            }
        }

        /// <summary>One connection, from the handshake to its end. The reason of a failure is kept.</summary>
        async Task ConnectOnceAsync()
        {
            _closeCode = 0;
            using (var socket = new ClientWebSocket())
            using (CancellationTokenSource cancel = CancellationTokenSource.CreateLinkedTokenSource(_closing.Token))
            {
                socket.Options.AddSubProtocol(Subprotocol);
                string key = _key;
                if (key != null && KeyAsSubprotocol) socket.Options.AddSubProtocol("adverb.bearer." + key);
                else if (key != null) socket.Options.SetRequestHeader("Authorization", "Bearer " + key);
                try
                {
                    await WithinAsync(socket.ConnectAsync(_uri, cancel.Token), socket,
                        cancel.Token).ConfigureAwait(false);
                    if (socket.SubProtocol != Subprotocol)
                        throw new AdverbException("closed", _uri + " does not support " + Subprotocol);
                    await ServeAsync(socket, cancel).ConfigureAwait(false);
                }
                catch (Exception error) when (!(error is AdverbException))
                {
                    _failure = error.Message;
                }
            }
        }

        /// <summary>Ends the stream where the server refuses the key: handshakes do not state the reason.</summary>
        async Task CheckAccessAsync()
        {
            string key = _key;
            try
            {
                using (var client = new AdverbClient(_root, key, HelloTimeoutS))
                {
                    Dictionary<string, object> access = await client.AccessAsync().ConfigureAwait(false);
                    object scopes;
                    access.TryGetValue("scopes", out scopes);
                    var list = scopes as List<object>;
                    if (key != null && list != null && list.Count > 0 && !list.Contains("pose")
                        && !list.Contains("admin"))
                        throw new AdverbException("missing_scope", "the key does not have the scope pose", 403);
                }
            }
            catch (AdverbException error)
            {
                if (IsRefusal(error) && key == _key) throw;
            }
        }

        static async Task WithinAsync(Task task, ClientWebSocket socket, CancellationToken cancel)
        {
            Task patience = Task.Delay(TimeSpan.FromSeconds(HelloTimeoutS), cancel);
            if (await Task.WhenAny(task, patience).ConfigureAwait(false) != task)
            {
                socket.Abort();
                throw new TimeoutException("no answer within " + HelloTimeoutS + " s");
            }
            await task.ConfigureAwait(false);
        }

        /// <summary>Reads until the connection ends; writes and pings beside it.</summary>
        async Task ServeAsync(ClientWebSocket socket, CancellationTokenSource cancel)
        {
            _receivedS = NowS;
            Task write = WriteAsync(socket, cancel.Token), ping = PingAsync(socket, cancel.Token);
            try
            {
                using (_closing.Token.Register(() => AbortLater(socket))) await ReadAsync(socket).ConfigureAwait(false);
                _failure = "the connection ended: " + (int)(socket.CloseStatus ?? 0) + " "
                    + socket.CloseStatusDescription;
            }
            finally
            {
                if (socket.CloseStatus != null) _closeCode = (int)socket.CloseStatus.Value;
                cancel.Cancel();
                socket.Abort();
                await Quiet(write).ConfigureAwait(false);
                await Quiet(ping).ConfigureAwait(false);
            }
        }

        /// <summary>Breaks a connection whose server does not answer its end within a second.</summary>
        static async void AbortLater(ClientWebSocket socket)
        {
            await Task.Delay(1000).ConfigureAwait(false);
            try
            {
                socket.Abort();
            }
            catch (ObjectDisposedException)
            {
                return; // it has ended in time
            }
        }

        static async Task Quiet(Task task)
        {
            try
            {
                await task.ConfigureAwait(false);
            }
            catch (Exception)
            {
                return; // the reader reports the end of the connection
            }
        }

        async Task ReadAsync(ClientWebSocket socket)
        {
            var buffer = new byte[65536];
            while (true)
            {
                int length = 0;
                WebSocketReceiveResult part;
                do
                {
                    if (length == buffer.Length) Array.Resize(ref buffer, 2 * length);
                    if (length > MaxMessageBytes) throw new InvalidOperationException("a message is too long");
                    var free = new ArraySegment<byte>(buffer, length, buffer.Length - length);
                    part = await socket.ReceiveAsync(free, CancellationToken.None).ConfigureAwait(false);
                    length += part.Count;
                }
                while (!part.EndOfMessage);
                if (part.MessageType == WebSocketMessageType.Close) return;
                _receivedS = NowS;
                lock (Gate) Receive(buffer, length, part.MessageType == WebSocketMessageType.Text, NowS);
            }
        }

        async Task WriteAsync(ClientWebSocket socket, CancellationToken cancel)
        {
            try
            {
                await WriteMessagesAsync(socket, cancel).ConfigureAwait(false);
            }
            catch (OperationCanceledException) when (_closing.IsCancellationRequested)
            {
                await socket.CloseOutputAsync(WebSocketCloseStatus.NormalClosure, "",
                    CancellationToken.None).ConfigureAwait(false);
            }
        }

        async Task WriteMessagesAsync(ClientWebSocket socket, CancellationToken cancel)
        {
            var messages = new List<object>();
            while (true)
            {
                await _outbox.WaitAsync(cancel).ConfigureAwait(false);
                messages.Clear();
                lock (Gate)
                {
                    _outbox.Take(messages);
                    for (int k = 0; k < messages.Count; k++)
                        // they change under the lock
                        if (!(messages[k] is byte[])) messages[k] = Json.Write(messages[k]);
                }
                foreach (object each in messages)
                {
                    byte[] content = each as byte[] ?? Encoding.UTF8.GetBytes((string)each);
                    WebSocketMessageType type = each is byte[] ? WebSocketMessageType.Binary
                        : WebSocketMessageType.Text;
                    await socket.SendAsync(new ArraySegment<byte>(content), type, true,
                        CancellationToken.None).ConfigureAwait(false);
                }
            }
        }

        /// <summary>Estimates the server's clock, quickly at first, and breaks a connection that is silent.</summary>
        async Task PingAsync(ClientWebSocket socket, CancellationToken cancel)
        {
            for (int k = 0; ; k++)
            {
                await Task.Delay(k < 5 ? 100 : 1000, cancel).ConfigureAwait(false);
                if (NowS - _receivedS > SilenceS) socket.Abort();
                lock (Gate)
                {
                    if (_hello == null) continue;
                    Ping(NowS);
                    foreach (int number in _notReady) if (_channels.ContainsKey(number)) Reopen(_channels[number]);
                    _notReady.Clear();
                }
            }
        }

        // --- session: everything below runs under the lock ---

        void Connected(Dictionary<string, object> hello, double nowS)
        {
            _hello = hello;
            Json.Text(hello, "session");
            _connected = true;
            _lateness.Clear(); // another connection may take another route
            if (_session.Length > 0 && _channels.Count > 0)
            {
                _confirmed.Clear();
                Dictionary<string, object> resume = Message("resume", "session", _session);
                resume["last_seq"] = (long)_sequence;
                Send(resume);
                _barrier = Ping(nowS); // its pong follows the whole answer to resume
            }
            else Begin(nowS);
            _ready.TrySetResult(true);
        }

        void Disconnected()
        {
            if (_live) Emit(new StreamEvent { Kind = StreamEventKind.Lost, Detail = _failure, CloseCode = _closeCode });
            _live = false;
            _hello = null;
            _barrier = 0;
            _notReady.Clear();
            _pings.Clear();
            _outbox.Clear();
            if (double.IsNaN(_lostS) && _session.Length > 0) _lostS = NowS;
        }

        /// <summary>Starts a new session and opens all channels with their current settings.</summary>
        void Begin(double nowS)
        {
            _droppedBefore = Stats.Dropped;
            _session = Json.Text(_hello, "session");
            _sequence = 0;
            _layouts.Clear();
            _lateness.Clear();
            Clock.Clear();
            _live = true;
            if (_view != null) Send(_view);
            foreach (AdverbChannel channel in _channels.Values) Reopen(channel);
            Restored(nowS, false);
        }

        void Reopen(AdverbChannel channel)
        {
            channel.CommitSwitch();
            channel.Buffer.Restart();
            Send(channel.OpenMessage());
            Dictionary<string, object> settings = channel.HasAllAdverbs ? null : channel.SetMessage();
            if (settings != null) Send(settings); // `open` takes all adverbs or none
        }

        /// <summary>Goes live after a resume: applies the current settings of all channels.</summary>
        void Join(double nowS)
        {
            _live = true;
            if (_view != null) Send(_view);
            foreach (AdverbChannel channel in _channels.Values)
            {
                if (!_confirmed.Contains(channel.Number)) Reopen(channel);
                else if (channel.Switch != null) Send(channel.Switch);
                else
                {
                    Dictionary<string, object> settings = channel.SetMessage();
                    if (settings != null) Send(settings);
                }
            }
            Restored(nowS, true);
        }

        void Restored(double nowS, bool resumed)
        {
            if (double.IsNaN(_lostS)) return;
            Stats.Reconnects++;
            if (resumed) Stats.Resumes++;
            Emit(new StreamEvent { Kind = StreamEventKind.Restored, Resumed = resumed, OutageS = nowS - _lostS });
            _lostS = double.NaN;
        }

        long Ping(double nowS)
        {
            long token = ++_lastPing;
            _pings[token] = nowS;
            _pings.Remove(token - MaxPings);
            Send(Message("ping", "t", token));
            return token;
        }

        void Receive(byte[] content, int length, bool text, double nowS)
        {
            Stats.Bytes += length;
            try
            {
                if (text) ReceiveText(Encoding.UTF8.GetString(content, 0, length), nowS);
                else ReceivePoses(content, length, nowS);
            }
            catch (AdverbException error)
            {
                Stats.DecodeErrors++;
                Stats.LastError = error.Detail;
                if (text) foreach (AdverbChannel channel in _channels.Values) Answer(channel, error);
            }
        }

        void ReceivePoses(byte[] content, int length, double nowS)
        {
            _message.Read(content, length, _layouts);
            Stats.Messages++;
            Stats.Dropped = _droppedBefore + _message.Dropped;
            uint step = unchecked(_message.Sequence - _sequence);
            if (step == 0 || step >= 0x80000000u)
            {
                Stats.Stale++;
                return;
            }
            if (step > 1 && _sequence != 0)
            {
                Stats.Gaps++;
                Stats.Missing += step - 1;
            }
            _sequence = _message.Sequence;
            double due = _message.TimeNs * 1e-9;
            _lateness.Add(nowS, due);
            bool irregular = _view != null && _view.ContainsKey("budget_kbps");
            for (int k = 0; k < _message.Count; k++)
            {
                AdverbChannel channel;
                Stats.Records++;
                // closed
                if (!_channels.TryGetValue(_message[k].Channel, out channel) || channel.Info == null) continue;
                channel.Buffer.Push(due, _message[k], irregular);
                channel.PendingPhase = double.NaN;
            }
        }

        void ReceiveText(string text, double nowS)
        {
            Dictionary<string, object> fields = Json.ParseObject(text);
            string op = Json.Text(fields, "op");
            if (_hello == null)
            {
                if (op != "hello") throw new AdverbException("malformed", "the server's first message is not hello");
                Connected(fields, nowS);
                return;
            }
            StreamEvent found;
            switch (op)
            {
                case "opened": Opened((int)Json.Integer(fields, "channel"), ChannelInfo.Of(fields)); break;
                case "error": Rejected(fields, nowS); break;
                case "pong": Pong((long)Json.Number(fields, "t"), Json.Integer(fields, "server_time_ns"), nowS); break;
                case "events":
                    foreach (object item in Json.Items(fields, "items")) Emit(ServerEvents.Keytime(item));
                    break;
                default:
                    found = ServerEvents.Of(op, fields);
                    if (found == null) break; // of a newer server, or a second hello
                    if (found.Kind == StreamEventKind.Version)
                        CheckVersion(found.Channel, (int)Json.Integer(fields, "record_bytes"));
                    AdverbChannel channel;
                    if (found.Kind == StreamEventKind.End && _channels.TryGetValue(found.Channel, out channel))
                        channel.Buffer.End();
                    if (found.Kind == StreamEventKind.Drain) _drainS = Json.Number(fields, "reconnect_after_s");
                    Emit(found);
                    break;
            }
        }

        void Opened(int number, ChannelInfo opened)
        {
            AdverbChannel channel;
            _layouts[number] = opened.Layout;
            if (!_channels.TryGetValue(number, out channel))
            {
                Send(Message("close", "channel", number)); // it was closed, or timed out, before the answer arrived
                return;
            }
            _confirmed.Add(number);
            _notReady.Remove(number);
            channel.ApplyOpened(opened);
            if (channel.Switch == null) Answer(channel, null);
            Emit(new StreamEvent { Kind = StreamEventKind.Opened, Channel = number, Name = opened.Verb,
                Version = opened.Version, Resumed = opened.Resumed });
        }

        void CheckVersion(int number, int recordBytes)
        {
            WireLayout old;
            if (_layouts.TryGetValue(number, out old) && old.Encoding != Encodings.Weights
                && old.RecordBytes != recordBytes)
                throw new AdverbException("malformed", "record_bytes of channel " + number + " changes");
        }

        void Pong(long token, long serverTimeNs, double nowS)
        {
            double sent;
            if (_pings.TryGetValue(token, out sent)) Clock.Add(sent, nowS, serverTimeNs);
            _pings.Remove(token);
            if (token != _barrier) return;
            _barrier = 0;
            Join(nowS);
        }

        void Rejected(Dictionary<string, object> fields, double nowS)
        {
            var error = new AdverbException(Json.Text(fields, "code"), Json.Text(fields, "detail"));
            object at;
            fields.TryGetValue("channel", out at);
            int number = at == null ? -1 : (int)Json.Number(at, "channel");
            if (error.Code == "unknown_session" && _barrier != 0)
            {
                _barrier = 0;
                Begin(nowS);
                return;
            }
            AdverbChannel channel;
            bool known = _channels.TryGetValue(number, out channel);
            bool open = known && channel.Info != null && _layouts.ContainsKey(number);
            // a setting after an `open` that was not ready
            if (known && !open && error.Code == "unknown_channel") return;
            if (known && error.Code == "channel_in_use")
            {
                InUse(channel);
                return;
            }
            if (number < 0 && error.Code == "bad_message") channel = OnlyPending();
            if (channel != null && channel.Pending != null)
            {
                Answer(channel, error);
                return;
            }
            if (known && !open)
            {
                channel.Error = error;
                if (error.Code == "not_ready")
                {
                    _notReady.Add(number);
                    return;
                }
            }
            Emit(new StreamEvent { Kind = StreamEventKind.Error, Channel = number, Error = error,
                Detail = error.Detail });
        }

        // An `open` was repeated, of this channel or of a closed one with its number.
        void InUse(AdverbChannel channel)
        {
            if (channel.Info == null)
            {
                Send(Message("close", "channel", channel.Number));
                Reopen(channel);
            }
            else if (channel.Switch == null) Answer(channel, null);
        }

        AdverbChannel OnlyPending()
        {
            AdverbChannel found = null;
            foreach (AdverbChannel each in _channels.Values)
            {
                if (each.Pending == null) continue;
                if (found != null) return null;
                found = each;
            }
            return found;
        }

        static void Answer(AdverbChannel channel, AdverbException error)
        {
            TaskCompletionSource<AdverbException> pending = channel.Pending;
            channel.Pending = null;
            if (pending != null) pending.TrySetResult(error);
        }
    }

    /// <summary>Events that messages of the server state.</summary>
    static class ServerEvents
    {
        /// <summary>Event of a message; null for an unknown op.</summary>
        internal static StreamEvent Of(string op, Dictionary<string, object> fields)
        {
            switch (op)
            {
                case "version":
                    return new StreamEvent { Kind = StreamEventKind.Version,
                        Channel = (int)Json.Integer(fields, "channel"),
                        Version = Json.Integer(fields, "version") };
                case "end":
                    return new StreamEvent { Kind = StreamEventKind.End,
                        Channel = (int)Json.Integer(fields, "channel") };
                case "drain":
                    Json.Number(fields, "reconnect_after_s");
                    return new StreamEvent { Kind = StreamEventKind.Drain, Detail = Json.Text(fields, "detail") };
                case "stats":
                    foreach (string name in new[] { "seconds", "kbps", "budget_kbps", "records", "left_out", "min_fps",
                        "max_fps" })
                        Json.Number(fields, name);
                    return new StreamEvent { Kind = StreamEventKind.Stats, Fields = fields };
                default: return null;
            }
        }

        internal static StreamEvent Keytime(object item)
        {
            Dictionary<string, object> row = Json.AsObject(item, "an event");
            return new StreamEvent { Kind = StreamEventKind.Keytime, Channel = (int)Json.Integer(row, "channel"),
                Name = Json.Text(row, "name"), Phase = Json.Number(row, "phase") };
        }
    }

    /// <summary>Arrays and facts of a verb file (docs/artifact.md), checked.</summary>
    sealed class VerbFile
    {
        internal const int Format = 2;
        const int MaxHeaderBytes = 16 * 1024 * 1024;

        internal Dictionary<string, object> Facts;
        readonly byte[] _file;
        readonly int _start;
        readonly SortedDictionary<string, Entry> _entries = new SortedDictionary<string, Entry>(StringComparer.Ordinal);

        sealed class Entry
        {
            internal string Type;
            internal long[] Shape;
            internal int Begin, Bytes, Count;
        }

        internal VerbFile(byte[] file)
        {
            _file = file;
            if (file.Length < 16) throw Bad("not a verb file: it is too short");
            ulong length = BitConverter.ToUInt64(file, 0);
            if (length < 2 || length > MaxHeaderBytes || length > (ulong)file.Length - 8)
                throw Bad("not a verb file: it is not a safetensors file");
            _start = 8 + (int)length;
            try
            {
                string text = new UTF8Encoding(false, true).GetString(file, 8, (int)length);
                Dictionary<string, object> header = Json.ParseObject(text);
                string facts = Json.Text(Json.AsObject(Json.Get(header, "__metadata__"), "__metadata__"), "adverb");
                Facts = Json.ParseObject(facts);
                long format = Json.Integer(Facts, "format");
                if (format < 1 || format > Format)
                    throw Bad("the file has format " + format + "; this client reads up to " + Format);
                foreach (KeyValuePair<string, object> each in header)
                    if (each.Key != "__metadata__")
                        _entries.Add(each.Key, EntryOf(each.Key, Json.AsObject(each.Value, each.Key)));
                Verify(facts);
            }
            catch (Exception error) when (error is ArgumentException || error is AdverbException
                && ((AdverbException)error).Code == "malformed")
            {
                throw Bad("not a verb file: its header is invalid: " + error.Message);
            }
        }

        internal bool Has(string name)
        {
            return _entries.ContainsKey(name);
        }

        /// <summary>An array of float64 or int64 by its shape; −1 stands for any length.</summary>
        internal double[] Doubles(string name, params long[] shape)
        {
            Entry entry = Find(name, shape);
            var found = new double[entry.Count];
            if (entry.Type == "F64") Buffer.BlockCopy(_file, entry.Begin, found, 0, entry.Bytes);
            else if (entry.Type == "I64")
                for (int k = 0; k < found.Length; k++) found[k] = BitConverter.ToInt64(_file, entry.Begin + 8 * k);
            else throw Bad("array '" + name + "' has the type " + entry.Type);
            foreach (double value in found)
                if (double.IsNaN(value) || double.IsInfinity(value)) throw Bad("array '" + name + "' is not finite");
            return found;
        }

        /// <summary>An array of float32 by its shape.</summary>
        internal float[] Floats(string name, params long[] shape)
        {
            Entry entry = Find(name, shape);
            if (entry.Type != "F32") throw Bad("array '" + name + "' has the type " + entry.Type);
            var found = new float[entry.Count];
            Buffer.BlockCopy(_file, entry.Begin, found, 0, entry.Bytes);
            foreach (float value in found)
                if (float.IsNaN(value) || float.IsInfinity(value)) throw Bad("array '" + name + "' is not finite");
            return found;
        }

        internal int Rows(string name)
        {
            Entry entry;
            if (!_entries.TryGetValue(name, out entry) || entry.Shape.Length == 0)
                throw Bad("array '" + name + "' is missing");
            return (int)entry.Shape[0];
        }

        internal static AdverbException Bad(string detail)
        {
            return new AdverbException("artifact_invalid", detail);
        }

        Entry Find(string name, long[] shape)
        {
            Entry entry;
            bool fits = _entries.TryGetValue(name, out entry) && entry.Shape.Length == shape.Length;
            for (int k = 0; fits && k < shape.Length; k++) fits = shape[k] == -1 || entry.Shape[k] == shape[k];
            if (!fits) throw Bad("the file does not describe a verb: array '" + name + "'");
            return entry;
        }

        Entry EntryOf(string name, Dictionary<string, object> fields)
        {
            var found = new Entry { Type = Json.Text(fields, "dtype") };
            List<object> shape = Json.Items(fields, "shape"), offsets = Json.Items(fields, "data_offsets");
            if (Array.IndexOf(new[] { "F32", "F64", "I64" }, found.Type) < 0)
                throw Bad("array '" + name + "' has the type " + found.Type);
            if (shape.Count > 4 || offsets.Count != 2) throw Bad("array '" + name + "' has an impossible shape");
            found.Shape = new long[shape.Count];
            double count = 1.0;
            for (int k = 0; k < shape.Count; k++)
            {
                if (!(shape[k] is long) || (long)shape[k] < 0 || (long)shape[k] > int.MaxValue)
                    throw Bad("array '" + name + "' has an impossible shape");
                found.Shape[k] = (long)shape[k];
                count *= found.Shape[k];
            }
            double begin = Json.Number(offsets[0], name), end = Json.Number(offsets[1], name);
            if (!(begin >= 0 && end - begin == count * (found.Type == "F32" ? 4 : 8) && _start + end <= _file.Length))
                throw Bad("array '" + name + "' does not fit into the file");
            found.Begin = _start + (int)begin;
            found.Bytes = (int)(end - begin);
            found.Count = (int)count;
            return found;
        }

        void Verify(string facts)
        {
            using (SHA256 sha = SHA256.Create())
            {
                Feed(sha, WithoutChecksum(facts));
                foreach (KeyValuePair<string, Entry> each in _entries)
                {
                    Entry entry = each.Value;
                    string type = entry.Type == "F32" ? "<f4" : entry.Type == "F64" ? "<f8" : "<i8";
                    string sides = string.Join(", ", Array.ConvertAll(entry.Shape, side =>
                        side.ToString(CultureInfo.InvariantCulture)));
                    Feed(sha, "\n" + each.Key + ":" + type + ":(" + sides + (entry.Shape.Length == 1 ? "," : "")
                        + ")\n");
                    sha.TransformBlock(_file, entry.Begin, entry.Bytes, null, 0);
                }
                sha.TransformFinalBlock(new byte[0], 0, 0);
                string found = BitConverter.ToString(sha.Hash).Replace("-", "").ToLowerInvariant();
                object stated;
                Facts.TryGetValue("sha256", out stated);
                if (found != stated as string) throw Bad("the checksum does not match: the file is damaged");
            }
        }

        static void Feed(SHA256 sha, string text)
        {
            byte[] bytes = Encoding.UTF8.GetBytes(text);
            sha.TransformBlock(bytes, 0, bytes.Length, null, 0);
        }

        /// <summary>The text without the entry `sha256` of its outermost object, whose keys are sorted.</summary>
        static string WithoutChecksum(string text)
        {
            int depth = 0;
            for (int k = 0; k < text.Length; k++)
            {
                char each = text[k];
                if (each == '{' || each == '[') depth++;
                else if (each == '}' || each == ']') depth--;
                else if (each == '"')
                {
                    int end = EndOfText(text, k);
                    if (depth == 1 && string.CompareOrdinal(text, k, "\"sha256\":", 0, 9) == 0)
                    {
                        int after = EndOfText(text, text.IndexOf('"', end + 1)) + 1;
                        if (after < text.Length && text[after] == ',') return text.Remove(k, after + 2 - k);
                        return text.Remove(k - 2, after - k + 2);
                    }
                    k = end;
                }
            }
            throw Bad("the file has no checksum");
        }

        static int EndOfText(string text, int k)
        {
            int end = k + 1;
            while (end < text.Length && text[end] != '"') end += text[end] == '\\' ? 2 : 1;
            return end;
        }
    }

    /// <summary>Coordinates in which an adverb space is convex.</summary>
    sealed class Chart
    {
        const int Cylinder = 1, Planar = 2;
        readonly int _kind, _i, _j, _m;
        readonly double[] _bend, _shift, _scale;

        internal Chart(VerbFile file, string prefix, long kind, int dims)
        {
            double[] axes = file.Doubles(prefix + ".chart.axes", 3);
            _kind = (int)kind;
            _i = (int)axes[0];
            _j = (int)axes[1];
            _m = (int)axes[2];
            bool used = _kind != 0;
            if (kind < 0 || kind > 2 || used
                && (Math.Min(_i, Math.Min(_j, _m)) < 0 || Math.Max(_i, Math.Max(_j, _m)) >= dims))
                throw VerbFile.Bad("the file does not describe a verb: chart '" + prefix + "'");
            _bend = file.Doubles(prefix + ".chart.bend", 4);
            _shift = file.Doubles(prefix + ".chart.shift", dims);
            _scale = file.Doubles(prefix + ".chart.scale", dims);
        }

        /// <summary>Normalised chart coordinates of adverbs.</summary>
        internal void To(double[] adverbs, double[] point)
        {
            Array.Copy(adverbs, point, point.Length);
            if (_kind == Cylinder)
            {
                double x = adverbs[_i] - _bend[0], z = adverbs[_m] - _bend[1], turn = 2.0 * Math.PI;
                double angle = Math.Atan2(x, z) - _bend[2];
                point[_i] = _bend[3] * (angle - turn * Math.Floor(angle / turn));
                point[_m] = Math.Sqrt(x * x + z * z);
            }
            else if (_kind == Planar)
            {
                double distance = adverbs[_i], direction = adverbs[_j] * (_bend[0] != 0.0 ? _bend[0] : 1.0);
                point[_i] = distance * Math.Sin(direction);
                point[_j] = distance * Math.Cos(direction);
            }
            for (int a = 0; a < point.Length; a++) point[a] = (point[a] - _shift[a]) * _scale[a];
        }

        /// <summary>Adverbs of chart coordinates.</summary>
        internal void From(double[] point, double[] adverbs)
        {
            for (int a = 0; a < adverbs.Length; a++) adverbs[a] = point[a] / _scale[a] + _shift[a];
            if (_kind == Cylinder)
            {
                double angle = adverbs[_i] / _bend[3] + _bend[2], radius = adverbs[_m];
                adverbs[_i] = _bend[0] + radius * Math.Sin(angle);
                adverbs[_m] = _bend[1] + radius * Math.Cos(angle);
            }
            else if (_kind == Planar)
            {
                double x = adverbs[_i], z = adverbs[_j];
                adverbs[_i] = Math.Sqrt(x * x + z * z);
                adverbs[_j] = x != 0.0 || z != 0.0 ? Math.Atan2(x, z) / (_bend[0] != 0.0 ? _bend[0] : 1.0) : 0.0;
            }
        }
    }

    /// <summary>The hull of a verb's adverbs: {u : facets · (u − middle) ≤ 1} in a chart.</summary>
    sealed class Domain
    {
        const double FreeGauge = 1.08, LastGauge = 1.25;
        readonly Chart _chart;
        readonly double[] _facets, _middle, _values, _point;
        readonly double _sharpness;

        internal Domain(VerbFile file, Dictionary<string, object> facts, int dims)
        {
            _chart = new Chart(file, "domain", Json.Integer(facts, "chart"), dims);
            _sharpness = Json.Number(facts, "sharpness");
            _facets = file.Doubles("domain.facets", -1, dims);
            _middle = file.Doubles("domain.middle", dims);
            _values = new double[_facets.Length / dims];
            _point = new double[dims];
        }

        internal void Middle(double[] adverbs)
        {
            _chart.From(_middle, adverbs);
        }

        /// <summary>Moves adverbs back to the domain's surroundings; returns whether that changed them.</summary>
        internal bool Clamp(double[] adverbs, double[] inside)
        {
            _chart.To(adverbs, _point);
            Array.Copy(adverbs, inside, inside.Length);
            double gauge = Gauge();
            if (gauge <= FreeGauge) return false;
            double span = LastGauge - FreeGauge;
            double shrink = (FreeGauge + span * Math.Tanh((gauge - FreeGauge) / span)) / gauge;
            for (int a = 0; a < _point.Length; a++) _point[a] = _middle[a] + (_point[a] - _middle[a]) * shrink;
            _chart.From(_point, inside);
            return true;
        }

        /// <summary>Smooth gauge of the point: 1 on the hull's surface.</summary>
        double Gauge()
        {
            double top = 0.0, total = 0.0;
            for (int f = 0, at = 0; f < _values.Length; f++)
            {
                double value = 0.0;
                for (int a = 0; a < _point.Length; a++, at++) value += _facets[at] * (_point[a] - _middle[a]);
                _values[f] = value;
                top = Math.Max(top, value);
            }
            if (top <= 0.0) return 0.0;
            foreach (double value in _values) if (value > 0.0) total += Math.Pow(value / top, _sharpness);
            return top * Math.Pow(total, 1.0 / _sharpness);
        }
    }

    /// <summary>Cardinal basis: adverbs in, one weight per example out.</summary>
    sealed class Basis
    {
        readonly Chart _chart;
        readonly int _kernel, _degree;
        readonly double[] _centers, _radii, _radial, _poly, _point;

        internal Basis(VerbFile file, string name, Dictionary<string, object> facts, int dims, int examples)
        {
            string prefix = "bases." + name;
            _kernel = (int)Json.Integer(facts, "kernel");
            _degree = (int)Json.Integer(facts, "degree");
            if (_kernel < 0 || _kernel > 5 || _degree < 0 || _degree > 2)
                throw VerbFile.Bad("the file does not describe a verb: basis '" + name + "'");
            int features = _degree == 0 ? 1 : _degree == 1 ? 1 + dims : 1 + dims + dims * (dims + 1) / 2;
            _chart = new Chart(file, prefix, Json.Integer(facts, "chart"), dims);
            _radii = file.Doubles(prefix + ".radii", -1);
            _centers = file.Doubles(prefix + ".centers", _radii.Length, dims);
            _radial = file.Doubles(prefix + ".radial", _radii.Length, examples);
            _poly = file.Doubles(prefix + ".poly", features, examples);
            _point = new double[dims];
        }

        /// <summary>Weights of adverbs inside the domain.</summary>
        internal void Weights(double[] adverbs, double[] weights)
        {
            int dims = _point.Length, row = 0;
            _chart.To(adverbs, _point);
            Array.Clear(weights, 0, weights.Length);
            if (_degree >= 1) for (int a = 0; a < dims; a++) Add(weights, _point[a], _poly, row++);
            if (_degree >= 2)
                for (int a = 0; a < dims; a++)
                    for (int b = a; b < dims; b++) Add(weights, _point[a] * _point[b], _poly, row++);
            Add(weights, 1.0, _poly, row);
            for (int c = 0; c < _radii.Length; c++)
            {
                double squared = 0.0;
                for (int a = 0; a < dims; a++)
                {
                    double side = _point[a] - _centers[c * dims + a];
                    squared += side * side;
                }
                double value = Radial(Math.Sqrt(squared) / _radii[c]);
                if (value != 0.0) Add(weights, value, _radial, c);
            }
        }

        double Radial(double r)
        {
            switch (_kernel)
            {
                case 0: // cubic B-spline
                    if (r >= 2.0) return 0.0;
                    return r >= 1.0 ? (2.0 - r) * (2.0 - r) * (2.0 - r) / 6.0 : 2.0 / 3.0 - r * r + 0.5 * r * r * r;
                case 1: return -Math.Sqrt(r * r + 1.0); // multiquadric
                case 2: return -r; // biharmonic
                case 3: return r > 0.0 ? r * r * Math.Log(r) : 0.0; // thin plate
                case 4: return r * r * r; // cubic
                default: // Wendland C²
                    double v = 1.0 - 0.5 * r;
                    return v > 0.0 ? v * v * v * v * (2.0 * r + 1.0) : 0.0;
            }
        }

        static void Add(double[] weights, double share, double[] coefficients, int row)
        {
            for (int i = 0, at = row * weights.Length; i < weights.Length; i++, at++)
                weights[i] += share * coefficients[at];
        }
    }

    /// <summary>Seconds and canonical time of one blend: a monotone cubic through its keytimes (Fritsch and Butland
    /// 1984).</summary>
    sealed class TimeWarp
    {
        const double NewtonEnd = 1e-7;
        readonly double[] _phases, _logLengths, _keytimes, _tangents;
        readonly bool _looping;

        internal TimeWarp(double[] phases, double[] keytimes, bool looping)
        {
            int marks = phases.Length, segments = marks - 1;
            _phases = phases;
            _looping = looping;
            _logLengths = new double[keytimes.Length / marks * segments];
            for (int k = 0; k < _logLengths.Length; k++)
            {
                int at = k / segments * marks + k % segments;
                _logLengths[k] = Math.Log(keytimes[at + 1] - keytimes[at]);
            }
            _keytimes = new double[marks];
            _tangents = new double[marks];
        }

        internal double DurationS { get { return _keytimes[_keytimes.Length - 1]; } }

        /// <summary>Sets the blend.</summary>
        internal void Set(double[] weights)
        {
            int segments = _phases.Length - 1;
            for (int m = 0; m < segments; m++)
            {
                double total = 0.0;
                for (int i = 0; i < weights.Length; i++) total += weights[i] * _logLengths[i * segments + m];
                _keytimes[m + 1] = _keytimes[m] + Math.Exp(total);
            }
            SetSlopes();
        }

        /// <summary>Seconds at a phase, 0 to 1.</summary>
        internal double TimeAt(double phase)
        {
            int s = Segment(_phases, phase);
            double width = _phases[s + 1] - _phases[s], u = (phase - _phases[s]) / width, v = 1.0 - u;
            return v * v * ((1.0 + 2.0 * u) * _keytimes[s] + u * width * _tangents[s])
                + u * u * ((3.0 - 2.0 * u) * _keytimes[s + 1] - v * width * _tangents[s + 1]);
        }

        /// <summary>Phase at seconds: the inverse of TimeAt, by Newton steps that bisection keeps in bounds.</summary>
        internal double PhaseAt(double timeS)
        {
            int s = Segment(_keytimes, timeS);
            double y0 = _keytimes[s], y1 = _keytimes[s + 1], width = _phases[s + 1] - _phases[s];
            if (timeS <= y0) return _phases[s];
            if (timeS >= y1) return _phases[s + 1];
            double m0 = width * _tangents[s], m1 = width * _tangents[s + 1];
            double low = 0.0, high = 1.0, u = (timeS - y0) / (y1 - y0);
            for (int k = 0; k < 60; k++)
            {
                double v = 1.0 - u;
                double miss = v * v * ((1.0 + 2.0 * u) * y0 + u * m0) + u * u * ((3.0 - 2.0 * u) * y1 - v * m1) - timeS;
                if (miss > 0.0) high = u;
                else low = u;
                double rate = 6.0 * u * v * (y1 - y0) + v * (1.0 - 3.0 * u) * m0 + u * (3.0 * u - 2.0) * m1;
                double after = rate > 0.0 ? u - miss / rate : 0.5 * (low + high);
                if (!(after >= low && after <= high)) after = 0.5 * (low + high);
                double moved = Math.Abs(after - u);
                u = after;
                if (moved < 1e-15 || moved < NewtonEnd && rate > 0.1 * (y1 - y0)) break;
            }
            return _phases[s] + u * width;
        }

        static int Segment(double[] knots, double at)
        {
            int s = 0;
            while (s < knots.Length - 2 && at >= knots[s + 1]) s++;
            return s;
        }

        double Width(int m)
        {
            return _phases[m + 1] - _phases[m];
        }

        double Secant(int m)
        {
            return (_keytimes[m + 1] - _keytimes[m]) / Width(m);
        }

        void SetSlopes()
        {
            int last = _phases.Length - 1;
            if (last == 1)
            {
                _tangents[0] = _tangents[1] = Secant(0);
                return;
            }
            for (int m = 1; m < last; m++) _tangents[m] = Inner(Width(m - 1), Width(m), Secant(m - 1), Secant(m));
            if (_looping)
            {
                _tangents[0] = _tangents[last] = Inner(Width(last - 1), Width(0), Secant(last - 1), Secant(0));
                return;
            }
            _tangents[0] = End(Width(0), Width(1), Secant(0), Secant(1));
            _tangents[last] = End(Width(last - 1), Width(last - 2), Secant(last - 1), Secant(last - 2));
        }

        static double Inner(double left, double right, double leftSecant, double rightSecant)
        {
            if (leftSecant * rightSecant <= 0.0) return 0.0;
            double a = 2.0 * right + left, b = right + 2.0 * left;
            return (a + b) / (a / leftSecant + b / rightSecant);
        }

        static double End(double near, double far, double nearSecant, double farSecant)
        {
            double slope = ((2.0 * near + far) * nearSecant - near * farSecant) / (near + far);
            if (slope * nearSecant <= 0.0) return 0.0;
            if (nearSecant * farSecant <= 0.0 && Math.Abs(slope) > 3.0 * Math.Abs(nearSecant)) return 3.0 * nearSecant;
            return slope;
        }
    }

    /// <summary>Roots that travel by blended steps in a turning frame.</summary>
    sealed class Walk
    {
        readonly double[] _strides; // K × N × 4: sideways, forward, turn, rise
        readonly bool _looping;
        readonly int _intervals;
        double[] _weights, _before = new double[4], _step = new double[4], _after = new double[4];
        readonly double[] _once = new double[4];

        /// <summary>x, z (m), heading (rad), height (m), from the origin.</summary>
        internal readonly double[] Place = new double[4];

        internal Walk(VerbFile file, int intervals, int examples, bool looping)
        {
            double[] planar = file.Doubles("strides", intervals, examples, 3);
            double[] rises = file.Has("rises") ? file.Doubles("rises", intervals, examples) : null;
            _intervals = intervals;
            _looping = looping;
            _strides = new double[4 * intervals * examples];
            for (int k = 0; k < intervals * examples; k++)
            {
                Array.Copy(planar, 3 * k, _strides, 4 * k, 3);
                if (rises != null) _strides[4 * k + 3] = rises[k];
            }
        }

        /// <summary>Walks to an unwrapped phase; 1.5 is the middle of the second cycle.</summary>
        internal void GoTo(double[] weights, double phase)
        {
            _weights = weights;
            Array.Clear(Place, 0, 4);
            double start = 0.0;
            if (_looping && phase >= 2.0)
            {
                start = Math.Floor(phase);
                GoCycles((int)start);
            }
            Go(start, phase);
        }

        /// <summary>Whole cycles; all have the displacement of the first.</summary>
        void GoCycles(int cycles)
        {
            Go(0.0, 1.0);
            Array.Copy(Place, _once, 4);
            Array.Clear(Place, 0, 4);
            for (int k = 0; k < cycles; k++)
            {
                double cosine = Math.Cos(Place[2]), sine = Math.Sin(Place[2]);
                Place[0] += _once[0] * cosine + _once[1] * sine;
                Place[1] += -_once[0] * sine + _once[1] * cosine;
                Place[2] += _once[2];
                Place[3] += _once[3];
            }
        }

        void Go(double start, double end)
        {
            double at = start * _intervals, stop = end * _intervals;
            if (at >= stop - 1e-12) return;
            int k = (int)Math.Floor(at + 1e-12);
            Step(k, _step);
            Step(_looping || k > 0 ? k - 1 : k, _before);
            while (at < stop - 1e-12)
            {
                double upto = Math.Min(k + 1, stop);
                Step(_looping || k < _intervals - 1 ? k + 1 : k, _after);
                Advance(Math.Min(Math.Max(at - k, 0.0), 1.0), Math.Min(Math.Max(upto - k, 0.0), 1.0));
                double[] free = _before;
                _before = _step;
                _step = _after;
                _after = free;
                at = upto;
                k++;
            }
        }

        void Advance(double u, double v)
        {
            double side = Part(u, v, 0), ahead = Part(u, v, 1), turn = Part(u, v, 2);
            double middle = Place[2] + 0.5 * turn, cosine = Math.Cos(middle), sine = Math.Sin(middle);
            Place[0] += side * cosine + ahead * sine;
            Place[1] += ahead * cosine - side * sine;
            Place[2] += turn;
            Place[3] += Part(u, v, 3);
        }

        double Part(double u, double v, int a)
        {
            return Covered(v, _step[a], _before[a], _after[a]) - Covered(u, _step[a], _before[a], _after[a]);
        }

        /// <summary>Part of a step covered at u: a cubic whose ends share their neighbours' mean speed.</summary>
        static double Covered(double u, double step, double before, double after)
        {
            double v = 1.0 - u;
            return u * u * (3.0 - 2.0 * u) * step + u * v * (v * 0.5 * (before + step) - u * 0.5 * (step + after));
        }

        void Step(int k, double[] step)
        {
            int row = (k % _intervals + _intervals) % _intervals;
            Array.Clear(step, 0, 4);
            for (int i = 0, at = 4 * row * _weights.Length; i < _weights.Length; i++, at += 4)
                for (int a = 0; a < 4; a++) step[a] += _weights[i] * _strides[at + a];
        }
    }

    /// <summary>A pose of an evaluator; its arrays are reused.</summary>
    public sealed class EvaluatedPose
    {
        /// <summary>Weights of the examples; they sum to 1 and may be negative.</summary>
        public double[] Weights = new double[0];

        /// <summary>Root x, y, z in metres, then local x, y, z, w per joint.</summary>
        public float[] Values = new float[0];

        /// <summary>Whether the adverbs were outside the domain and were moved back.</summary>
        public bool Clamped;

        /// <summary>Canonical time; beyond 1 in further cycles of a loop.</summary>
        public double Phase;

        /// <summary>Seconds from the start.</summary>
        public double TimeS;

        /// <summary>Duration of the motion or cycle, s.</summary>
        public double DurationS;
    }

    /// <summary>
    /// Evaluates a verb without a server: weights and phase, or adverbs by <c>rbf</c> or <c>refined</c>, to poses. They
    /// are those of the server with <c>plant: false</c>. Not for several threads at once; nothing is allocated per pose.
    /// </summary>
    public sealed class VerbEvaluator
    {
        const double Shortest = 0.3, MaxCycles = 1000.0, MaxTimeS = 3600.0;

        /// <summary>Name of the verb.</summary>
        public readonly string Name;

        /// <summary>Names of the examples, in the order of weights.</summary>
        public readonly string[] Examples;

        /// <summary>Whether the end of a cycle is the start of the next.</summary>
        public readonly bool Looping;

        /// <summary>Adverbs in their order.</summary>
        public readonly AdverbInfo[] Adverbs;

        /// <summary>Joints.</summary>
        public readonly Skeleton Skeleton;

        /// <summary>Names of the keytimes.</summary>
        public readonly string[] KeytimeNames;

        /// <summary>Canonical times of the keytimes.</summary>
        public readonly double[] KeytimePhases;

        readonly float[] _curves;
        readonly double[] _references, _sums, _given, _inside, _rotation = new double[4];
        readonly int _intervals;
        readonly bool _vectors;
        readonly TimeWarp _warp;
        readonly Walk _walk;
        readonly Domain _domain;
        readonly Dictionary<string, Basis> _bases = new Dictionary<string, Basis>(StringComparer.Ordinal);

        /// <summary>Reads the content of a verb file and compares its checksum.</summary>
        /// <exception cref="AdverbException">It is not a verb file, is damaged, or has a newer format:
        /// <c>artifact_invalid</c>.</exception>
        public VerbEvaluator(byte[] content)
        {
            var file = new VerbFile(content);
            try
            {
                Dictionary<string, object> facts = file.Facts;
                Name = Json.Text(facts, "name");
                Looping = Json.Flag(facts, "looping");
                Examples = Json.Texts(facts, "examples");
                KeytimeNames = Json.Texts(facts, "keytime_names");
                Adverbs = AdverbsOf(facts);
                int dims = Adverbs.Length, examples = Examples.Length;
                Skeleton = SkeletonOf(file, Json.Texts(facts, "joints"));
                int joints = Skeleton.Names.Length;
                _curves = file.Floats("curves", -1, examples, 4 + 4 * joints);
                _intervals = file.Rows("curves") - 3;
                if (_intervals < 1 || examples < 1 || dims < 1 || KeytimeNames.Length < 2)
                    throw VerbFile.Bad("the verb has no motion");
                _references = file.Doubles("references", joints, 4);
                _vectors = Json.Integer(facts, "rotation_mode") == 1;
                KeytimePhases = file.Doubles("phases", KeytimeNames.Length);
                _warp = new TimeWarp(KeytimePhases, file.Doubles("keytimes", examples, KeytimeNames.Length), Looping);
                if (Json.Integer(facts, "root_motion") == 1) _walk = new Walk(file, _intervals, examples, Looping);
                _domain = new Domain(file, Json.AsObject(Json.Get(facts, "domain"), "domain"), dims);
                foreach (KeyValuePair<string, object> each in Json.AsObject(Json.Get(facts, "bases"), "bases"))
                    _bases[each.Key] = new Basis(file, each.Key, Json.AsObject(each.Value, each.Key), dims, examples);
                _sums = new double[4 + 4 * joints];
                _given = new double[dims];
                _inside = new double[dims];
            }
            catch (AdverbException error) when (error.Code == "malformed")
            {
                throw VerbFile.Bad("the file does not describe a verb: " + error.Detail);
            }
        }

        /// <summary>Reads a verb file.</summary>
        public static VerbEvaluator Load(string path)
        {
            return new VerbEvaluator(File.ReadAllBytes(path));
        }

        /// <summary>Adverbs in the middle of the domain, in the verb's order.</summary>
        public double[] Middle()
        {
            var found = new double[Adverbs.Length];
            _domain.Middle(found);
            return found;
        }

        /// <summary>All adverbs in the verb's order, of adverbs by name.</summary>
        public double[] Ordered(IDictionary<string, double> adverbs)
        {
            var found = new double[Adverbs.Length];
            for (int k = 0; k < found.Length; k++)
                if (!adverbs.TryGetValue(Adverbs[k].Name, out found[k]))
                    throw new AdverbException("bad_request", "missing adverb " + Adverbs[k].Name);
            foreach (string name in adverbs.Keys)
                if (!Array.Exists(Adverbs, adverb => adverb.Name == name))
                    throw new AdverbException("unknown_adverb", "unknown adverb " + name);
            return found;
        }

        /// <summary>Pose at adverbs.</summary>
        /// <param name="adverbs">All adverbs in the verb's order.</param>
        /// <param name="phase">Canonical time 0–1; in a loop up to 1,000. NaN: see <paramref name="timeS"/>.</param>
        /// <param name="into">Written.</param>
        /// <param name="method"><c>rbf</c> or <c>refined</c>, which is <c>rbf</c> where there are no
        /// pseudo-examples.</param>
        /// <param name="timeS">Seconds from the start, where the phase is NaN.</param>
        public void Pose(double[] adverbs, double phase, EvaluatedPose into, string method = "rbf", double timeS = 0.0)
        {
            if (adverbs.Length != Adverbs.Length)
                throw new AdverbException("out_of_range", Name + " has " + Adverbs.Length + " adverbs");
            Array.Copy(adverbs, _given, adverbs.Length);
            for (int k = 0; k < _given.Length; k++)
                if (double.IsNaN(_given[k]) || double.IsInfinity(_given[k]))
                    throw new AdverbException("out_of_range", "adverb " + Adverbs[k].Name + " is not finite");
            Basis basis = null;
            bool known = method == "rbf" || method == "refined";
            if (!known || !(method == "refined" && _bases.TryGetValue("refined", out basis))
                && !_bases.TryGetValue("rbf", out basis))
                throw new AdverbException("unknown_method", "the evaluator has rbf and refined, not " + method);
            bool clamped = _domain.Clamp(_given, _inside);
            if (into.Weights.Length != Examples.Length) into.Weights = new double[Examples.Length];
            basis.Weights(_inside, into.Weights);
            PoseOf(into.Weights, phase, into, timeS);
            into.Clamped = clamped;
        }

        /// <summary>Pose of weights, as records of the encoding weights have them; see <see cref="Pose"/>.</summary>
        public void PoseOf(double[] weights, double phase, EvaluatedPose into, double timeS = 0.0)
        {
            if (weights.Length != Examples.Length)
                throw new AdverbException("out_of_range", Name + " has " + Examples.Length + " examples");
            if (into.Weights != weights) into.Weights = (double[])weights.Clone();
            if (into.Values.Length != 3 + _references.Length) into.Values = new float[3 + _references.Length];
            into.Clamped = false;
            _warp.Set(weights);
            Resolve(phase, timeS, into);
            Sum(weights, Looping ? into.Phase - Math.Floor(into.Phase) : into.Phase);
            for (int j = 0; j < _references.Length; j += 4) if (_vectors) RotateReference(j); else Normalise(j);
            if (_walk != null) Travel(weights, into.Phase);
            for (int a = 0; a < 3; a++) into.Values[a] = (float)_sums[a];
            for (int k = 3; k < into.Values.Length; k++) into.Values[k] = (float)_sums[k + 1];
        }

        void Resolve(double phase, double timeS, EvaluatedPose into)
        {
            bool byTime = double.IsNaN(phase);
            double given = byTime ? timeS : phase, most = byTime ? MaxTimeS : Looping ? MaxCycles : 1.0;
            if (!(given >= 0.0 && given <= most))
                throw new AdverbException("out_of_range", given.ToString(CultureInfo.InvariantCulture)
                    + " is not in 0 to " + most);
            double whole = byTime ? _warp.DurationS : 1.0, cycles = Looping ? Math.Floor(given / whole) : 0.0;
            double rest = Math.Min(Math.Max(given - cycles * whole, 0.0), whole);
            into.DurationS = _warp.DurationS;
            into.Phase = cycles + (byTime ? _warp.PhaseAt(rest) : rest);
            into.TimeS = cycles * into.DurationS + (byTime ? rest : _warp.TimeAt(rest));
        }

        /// <summary>Sum of the rows around a phase, four of them at a time.</summary>
        void Sum(double[] weights, double phase)
        {
            double x = phase * _intervals;
            int k = Math.Min(Math.Max((int)Math.Floor(x), 0), _intervals - 1), width = _sums.Length;
            double u = x - k, v = 1.0 - u;
            double tap0 = v * v * v / 6.0, tap1 = 2.0 / 3.0 - u * u + 0.5 * u * u * u;
            double tap2 = 2.0 / 3.0 - v * v + 0.5 * v * v * v, tap3 = u * u * u / 6.0;
            int stride = weights.Length * width;
            Array.Clear(_sums, 0, width);
            for (int i = 0; i < weights.Length; i++)
            {
                if (weights[i] == 0.0) continue;
                double a = tap0 * weights[i], b = tap1 * weights[i], c = tap2 * weights[i], d = tap3 * weights[i];
                int at = k * stride + i * width;
                for (int column = 0; column < width; column++, at++)
                    _sums[column] += a * _curves[at] + b * _curves[at + stride] + c * _curves[at + 2 * stride]
                        + d * _curves[at + 3 * stride];
            }
        }

        /// <summary>A sum that is too short becomes the reference of its joint.</summary>
        void Normalise(int r)
        {
            int at = r + 4;
            double squared = 0.0;
            for (int a = 0; a < 4; a++) squared += _sums[at + a] * _sums[at + a];
            if (!(squared >= Shortest * Shortest))
            {
                Array.Copy(_references, r, _sums, at, 4);
                return;
            }
            double scale = 1.0 / Math.Sqrt(squared);
            for (int a = 0; a < 4; a++) _sums[at + a] *= scale;
        }

        /// <summary>Reference · exp(rotation vector).</summary>
        void RotateReference(int r)
        {
            int at = r + 4;
            double x = _sums[at], y = _sums[at + 1], z = _sums[at + 2], angle = Math.Sqrt(x * x + y * y + z * z);
            double scale = angle > 1e-9 ? Math.Sin(0.5 * angle) / angle : 0.5;
            _rotation[0] = scale * x;
            _rotation[1] = scale * y;
            _rotation[2] = scale * z;
            _rotation[3] = Math.Cos(0.5 * angle);
            Quat.Multiply(_references, r, _rotation, 0, _sums, at);
        }

        /// <summary>Moves the pose, whose root has a height and no heading, to its place in the world.</summary>
        void Travel(double[] weights, double phase)
        {
            _walk.GoTo(weights, phase);
            _sums[0] = _walk.Place[0];
            _sums[1] += _walk.Place[3];
            _sums[2] = _walk.Place[1];
            _rotation[0] = _rotation[2] = 0.0;
            _rotation[1] = Math.Sin(0.5 * _walk.Place[2]);
            _rotation[3] = Math.Cos(0.5 * _walk.Place[2]);
            Quat.Multiply(_rotation, 0, _sums, 4, _sums, 4);
        }

        static AdverbInfo[] AdverbsOf(Dictionary<string, object> facts)
        {
            List<object> rows = Json.Items(facts, "adverbs"), ranges = Json.Items(facts, "ranges");
            if (ranges.Count != rows.Count) throw VerbFile.Bad("the file does not describe a verb: ranges");
            var found = new AdverbInfo[rows.Count];
            for (int k = 0; k < found.Length; k++)
            {
                Dictionary<string, object> row = Json.AsObject(rows[k], "an adverb");
                var range = ranges[k] as List<object>;
                if (range == null || range.Count != 2) throw VerbFile.Bad("the file does not describe a verb: ranges");
                found[k] = new AdverbInfo(Json.Text(row, "name"), Json.Text(row, "unit"),
                    Json.Number(range[0], "ranges"),
                    Json.Number(range[1], "ranges"), Json.Flag(row, "style"));
            }
            return found;
        }

        static Skeleton SkeletonOf(VerbFile file, string[] names)
        {
            double[] parents = file.Doubles("skeleton.parents", names.Length);
            return new Skeleton(names, Array.ConvertAll(parents, parent => (int)parent),
                file.Doubles("skeleton.offsets", names.Length, 3));
        }
    }
}
